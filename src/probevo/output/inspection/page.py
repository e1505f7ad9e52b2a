"""The self-contained page of ``probevo inspect``, and the pictures beside it."""

from __future__ import annotations

from pathlib import Path

from probevo.entry_points import imported
from probevo.errors import InputError
from probevo.noise.registry import kind_of
from probevo.output.inspection import predictors
from probevo.output.inspection.common_sections import frame_facts
from probevo.output.inspection.subject import Findings, Subject
from probevo.output.inspection.terms import meanings, terms_section
from probevo.output.page import write_page
from probevo.storage.files import remove_stale, write_atomically

PAGE = "inspection.html"
_MODEL_PICTURES = ("weight", "distance", "sigma", "dof")
"""Pictures that only some kinds of model have."""


def inspect(subject: Subject) -> Findings:
    """Find what there is to show of a model, of a frame, or of a frame as a model sees it.

    Raises:
        ValueError: there is neither a model nor a frame.
        InputError: the kind of the model has no page.
    """
    if subject.model is None:
        return predictors.sections(subject)
    kind = kind_of(subject.model)
    if not kind.inspection:
        raise InputError("--model", f"models of kind {kind.name} have no page to inspect.")
    findings: Findings = imported(kind.inspection)(subject)
    return findings


def write_inspection(out: Path, subject: Subject) -> Findings:
    """Write the page and, of a frame, its pictures. The same subject gives the same bytes.

    Args:
        out: folder for ``inspection.html`` and ``frame-K``. Pictures that an earlier inspection of
            the same frame left there are removed.
        subject: what to inspect.

    Raises:
        ValueError: there is neither a model nor a frame.
        InputError: the kind of the model has no page, or a file cannot be written.
    """
    findings = inspect(subject)
    if subject.frame is not None:
        folder = out / f"frame-{subject.frame.index}"
        for name in {*_MODEL_PICTURES, *subject.units} - set(findings.pictures):
            remove_stale(folder / f"{name}.jpg")
        for name, (_, jpeg) in findings.pictures.items():
            write_atomically(folder / f"{name}.jpg", jpeg)
    facts = {**frame_facts(subject.frame), **findings.facts}
    terms = terms_section(meanings(facts, findings.terms))
    write_page(out / PAGE, subject.title, facts, sections=[terms, *findings.sections])
    return findings
