"""The classical noise models by name; learned ones may scale them."""

from __future__ import annotations

from probevo.noise.fixed import Fixed
from probevo.noise.student_t import StudentT

CLASSICAL: dict[str, type[Fixed] | type[StudentT]] = {"fixed": Fixed, "student-t": StudentT}
