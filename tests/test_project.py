"""The project as a whole: side effects of imports, versions, files, documentation that runs."""

import builtins
import dis
import importlib
import inspect
import json
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer

import foresight_env

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("foresight_env", "agents", "evaluation", "benchmarks", "examples", "tests")

IMPORTS = """
import json, logging, pkgutil, importlib
import jax
compiled = []
class Count(logging.Handler):
    def emit(self, record):
        if "ompiling" in record.getMessage():
            compiled.append(record.getMessage())
for name in ("jax._src.interpreters.pxla", "jax._src.dispatch", "jax._src.compiler"):
    logger = logging.getLogger(name)
    logger.setLevel(logging.DEBUG)
    logger.addHandler(Count())
    logger.propagate = False
before = dict(jax.config.values)
import foresight_env
names = [m.name for m in pkgutil.walk_packages(foresight_env.__path__, "foresight_env.")]
for name in names:
    importlib.import_module(name)
changed = sorted(k for k, v in jax.config.values.items() if before.get(k) != v)
at_import = len(compiled)
jax.jit(lambda v: v + 1)(1.0)  # the counter works
print(json.dumps([changed, at_import, len(compiled) > at_import, names]))
"""


def test_importing_changes_no_configuration_and_compiles_nothing():
    run = subprocess.run(
        [sys.executable, "-c", IMPORTS], cwd=ROOT, capture_output=True, text=True, check=True
    )
    changed, compiled, counts, names = json.loads(run.stdout.splitlines()[-1])
    assert "foresight_env.inverse.estimate" in names
    assert changed == []
    assert compiled == 0
    assert counts


def sources():
    return [p for name in PACKAGES for p in (ROOT / name).rglob("*.py")]


def unknown_globals(module):
    """Names that functions of a module look up globally, and that are not defined.

    Linters cannot find them: words in jaxtyping's shapes look like names to them.
    """
    known = {*vars(module), *dir(builtins)}
    code = [compile(Path(module.__file__).read_text(encoding="utf-8"), module.__name__, "exec")]
    found = set()
    while code:
        part = code.pop()
        code += [c for c in part.co_consts if inspect.iscode(c)]
        found |= {i.argval for i in dis.get_instructions(part) if i.opname == "LOAD_GLOBAL"}
    return found - known


EXTRAS = {"evaluation.training.reinforcement": "stable_baselines3"}
"""Modules that only an extra lets one import."""


def test_every_name_is_defined():
    modules = [
        ".".join(p.relative_to(ROOT).with_suffix("").parts)
        for p in sources()
        if "tests" not in p.parts and "examples" not in p.parts and p.stem != "__main__"
    ]
    modules = [name for name in modules if name not in EXTRAS or find_spec(EXTRAS[name])]
    unknown = {name: unknown_globals(importlib.import_module(name)) for name in modules}
    assert {name: names for name, names in unknown.items() if names} == {}
    assert len(modules) > 80


def test_nothing_unpickles():
    """Files from elsewhere are data, not code."""
    unsafe = re.compile(r"\bpickle\.loads?\b|\bimport (cloudpickle|dill)\b|allow_pickle\s*=\s*True")
    here = Path(__file__).resolve()
    found = [p for p in sources() if p != here and unsafe.search(p.read_text(encoding="utf-8"))]
    assert len(sources()) > 20
    assert found == []


def test_the_changelog_tells_of_this_version():
    """Of a release, or of commits after one; the version without git is the latest release."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## \[([^\]]+)\]", text, re.MULTILINE)
    released = [name for name in sections if re.fullmatch(r"\d+\.\d+\.\d+", name)]
    base = re.match(r"\d+\.\d+\.\d+", foresight_env.__version__)
    assert base
    assert sections[0] in ("Unreleased", base[0])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["tool"]["hatch"]["version"]["fallback-version"] == released[0]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [released[0]]


def commands():
    """Lines that call `foresight` in shell blocks and tables of the documentation."""
    found = []
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text(encoding="utf-8").replace("\\\n", " ")
        shell = re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S)
        found += [line for block in shell for line in block.splitlines()]
        told = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
        found += re.findall(r"`(foresight [^`]+)`", told)
    return sorted({line.split("#")[0].strip() for line in found if line.startswith("foresight ")})


@pytest.mark.parametrize("line", commands())
def test_documented_commands_exist(line):
    """Every name and option in the documentation exists; nothing is run."""
    from evaluation.cli.app import app

    command, words = typer.main.get_command(app), shlex.split(line)[1:]
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    assert not words or not getattr(command, "commands", {}), f"{line}: no such command"
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known


LINKING = [p for p in ROOT.glob("*.md") if p.name != "CHANGELOG.md"]
LINKING += sorted((ROOT / "docs").rglob("*.md"))


@pytest.mark.parametrize("path", LINKING, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_to_files_lead_somewhere(path):
    """Relative links, as they are followed in the repository; `make docs` checks the site's."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    files = [link.partition("#")[0] for link in links if "://" not in link]
    assert [name for name in files if name and not (path.parent / name).exists()] == []


def test_the_first_screen_is_short():
    """The README: length, words in cells of tables, size of its film."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    cells = [c for line in text.splitlines() if line.startswith("|") for c in line.split("|")]
    assert [cell for cell in cells if len(re.sub(r"\]\([^)]*\)", "", cell).split()) > 12] == []
    (film,) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", text)
    assert (ROOT / film).stat().st_size < 2e6


@pytest.mark.parametrize(
    ("page", "link", "kept"),
    [
        ("index.md", "../README.md", False),
        ("index.md", "api/envs.md", True),
        ("api/envs.md", "../environments/index.md", True),
        ("api/envs.md", "../../README.md", False),
    ],
)
def test_links_within_the_site_are_kept(page, link, kept):
    """Files outside `docs` are no pages of the site."""
    pytest.importorskip("latex2mathml")
    made = runpy.run_path(str(ROOT / "docs" / "mathml.py"))["on_page_markdown"]
    told = made(f"See [it]({link}).", SimpleNamespace(file=SimpleNamespace(src_uri=page)))
    assert told == (f"See [it]({link})." if kept else "See it.")
