"""The run-time checker of annotations that pytest's `--jaxtyping-packages` applies."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An `int` is a `float` and a `float` a `complex`, as for static checkers."""
