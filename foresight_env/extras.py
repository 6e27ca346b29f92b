"""Optional dependencies: the extra that brings each one, and the error where one is missing."""

from __future__ import annotations

from importlib.util import find_spec

EXTRAS: dict[str, dict[str, str]] = {
    "evaluation": {
        "pyarrow": "pyarrow",
        "typer": "typer",
        "rich": "rich",
        "jinja2": "jinja2",
        "PIL": "pillow",
    },
    "learned": {"equinox": "equinox", "optax": "optax", "safetensors": "safetensors"},
    "rl": {"torch": "torch", "stable_baselines3": "stable-baselines3"},
    "cluster": {"distributed": "distributed"},
}
"""Extra -> imported module -> distribution that provides it."""


class MissingExtraError(ImportError):
    """A dependency of an extra is not installed; the message names the extra."""


def require(extra: str, what: str, *modules: str) -> None:
    """Check that an extra's modules are installed, without importing them.

    Args:
        extra: a key of `EXTRAS`.
        what: what needs it; the message begins with it.
        *modules: the modules of the extra that are needed; none given means all.

    Raises:
        MissingExtraError: at least one of them is not installed.
    """
    provided = EXTRAS[extra]
    missing = [provided[m] for m in modules or provided if find_spec(m) is None]
    if missing:
        raise MissingExtraError(
            f"{what}: needs {', '.join(missing)}; pip install 'foresight_env[{extra}]'"
        )
