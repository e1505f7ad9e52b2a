"""The packages of the extra ``nets``: whether they are there, and what to install if not."""

from __future__ import annotations

from importlib.util import find_spec

from probevo.errors import InputError

PACKAGES = ("jax", "equinox", "optax")


def require_nets(where: str) -> None:
    """Check that JAX, Equinox and Optax are installed, without importing them.

    Args:
        where: the command or option that needs them, for the message.

    Raises:
        InputError: one of them is missing.
    """
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        what = f"networks need the package{'s' * (len(missing) > 1)} {', '.join(missing)}."
        raise InputError(where, what, "Install probevo's extra: pip install 'probevo[nets]'.")
