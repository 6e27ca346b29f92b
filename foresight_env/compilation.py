"""How the library's programs are compiled, kept between runs, and announced.

Nothing here happens at import: a process keeps compiled programs once it calls
`enable_compilation_cache`, and announces long compilations once it calls `announce_compilation`.
The command `foresight` and the tests do both.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

COMPILER_OPTIONS = {
    # XLA's fusion emitters take a third of the time that compiling a solver takes, run it no
    # faster, and read wrong entries of some vectors on processors with AVX2 (jaxlib 0.8 to 0.10,
    # see tests/equilibrium/test_compilation.py). `benchmarks.compilation` compares.
    "xla_cpu_use_fusion_emitters": False,
}
UNOPTIMISED = {"xla_backend_optimization_level": 0}
LEAST_SECONDS = 0.3
"""Compilations that take longer than this are kept."""
SILENCE = 1.0
"""Seconds that a compilation lasts before it is announced: cached programs load faster."""


def compiled(
    *, static_argnums: int | Sequence[int] = (), optimised: bool = True
) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of the library on first use: `jax.jit` with `COMPILER_OPTIONS`.

    For functions that callers' traces never contain: JAX takes options at the outermost level only.
    Without LLVM's optimisation (`optimised=False`) small programs compile in a third of the time.
    """
    options = {**COMPILER_OPTIONS, **({} if optimised else UNOPTIMISED)}

    def decorate(function: Callable[..., Any]) -> Any:
        return jax.jit(function, static_argnums=static_argnums, compiler_options=options)

    return decorate


class _FirstTime:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.done = False


_first_times: dict[Hashable, _FirstTime] = {}
_finding = threading.Lock()


def forget_compilations() -> None:
    """Forget JAX's compiled programs, and what `first_time` remembers of them."""
    with _finding:
        _first_times.clear()
    jax.clear_caches()


@contextmanager
def first_time(key: Hashable) -> Iterator[bool]:
    """Give True until the context has once ended without an exception, then False.

    Other threads with an equal key wait for the first one.
    """
    with _finding:
        state = _first_times.setdefault(key, _FirstTime())
    if state.done:
        yield False
        return
    with state.lock:
        yield not state.done
        state.done = True


def signature(tree: Any) -> Hashable:
    """Return what a compiled program depends on: the tree's structure, shapes and types."""
    leaves, structure = jax.tree.flatten(tree)
    kinds = tuple((np.shape(v), getattr(v, "dtype", type(v))) for v in leaves)
    return structure, kinds


@contextmanager
def compiling(lowered: jax.stages.Lowered) -> Iterator[None]:
    """Compile a program in a second thread while the context lasts; XLA releases Python's lock.

    Later calls of the function that was lowered find the program. The context ends when both are
    done; an exception of the context comes before one of the compilation.
    """
    timer = _timers.pop(threading.get_ident(), None)

    def compile_it() -> None:
        if timer is not None:
            _timers[threading.get_ident()] = timer
        with jax.enable_x64(True):  # a context of the thread
            lowered.compile()

    with ThreadPoolExecutor(1, "compilation") as pool:
        compilation = pool.submit(compile_it)
        yield
    compilation.result()


def default_cache() -> Path:
    """Return where compiled programs are kept: `JAX_COMPILATION_CACHE_DIR`, or the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("JAX_COMPILATION_CACHE_DIR") or cache / "foresight_env" / "jax")


def enable_compilation_cache(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep compiled programs between runs, also those of processes that this one starts.

    Changes JAX's configuration and environment variables of this process, for callers that want
    that: nothing in the library calls it but the command line and worker processes. A first solve
    compiles for seconds, a first fit of four agents for some ten; later processes
    load the programs in a fraction of a second.

    Args:
        folder: where; None: `JAX_COMPILATION_CACHE_DIR` or the user's cache folder.

    Returns:
        The folder. Programs depend on the versions of JAX and on the processor; old ones may be
        deleted at any time.
    """
    path = Path(folder) if folder is not None else default_cache()
    settings = {
        "jax_compilation_cache_dir": str(path),
        "jax_persistent_cache_min_compile_time_secs": LEAST_SECONDS,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    # The one place where the library changes JAX's configuration: callers ask for it by name.
    for name, value in settings.items():
        os.environ[name.upper()] = str(value)
        jax.config.update(name, value)
    return path


_timers: dict[int, threading.Timer] = {}
_listeners: list[Callable[[str], object]] = []
_announced: list[Callable[[str], object]] = []
"""Those of them that have been called."""
_registered: list[bool] = []
_announcing = threading.Lock()


@contextmanager
def announce_compilation(tell: Callable[[str], object]) -> Iterator[None]:
    """Call `tell` with a line, once within this context, where a compilation takes over a second.

    From another thread: `tell` should only print.
    """
    if not _registered:
        _registered.append(True)
        jax.monitoring.register_event_duration_secs_listener(_listen)
    with _announcing:
        _listeners.append(tell)
    try:
        yield
    finally:
        with _announcing:
            _listeners.remove(tell)
            if tell in _announced:
                _announced.remove(tell)


def _listen(event: str, duration_secs: float, **details: str | int) -> None:
    thread = threading.get_ident()
    if event.endswith("jaxpr_to_mlir_module_duration"):  # what follows is XLA's part
        earlier = _timers.pop(thread, None)  # of a program that was lowered and not compiled
        if earlier is not None:
            earlier.cancel()
        timer = threading.Timer(SILENCE, _announce)
        timer.daemon = True
        _timers[thread] = timer
        timer.start()
    elif event.endswith("backend_compile_duration"):
        started = _timers.pop(thread, None)
        if started is not None:
            started.cancel()


def _announce() -> None:
    with _announcing:
        if not _listeners or _listeners[-1] in _announced:
            return
        tell = _listeners[-1]
        _announced.append(tell)
    tell("compiling the solver, once per machine; later runs load it")
