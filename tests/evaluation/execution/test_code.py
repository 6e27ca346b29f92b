"""The digest of the code: what changes it and what does not."""

import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.execution import code
from evaluation.execution.code import code_digest, digest_of

ROOT = Path(code.__file__).parents[2]
PLAIN = """
def area(radius):
    return 3.0 * radius**2
"""
SAME = '''
"""Areas."""

# Of discs.

def area(
    radius,
):
    """Area of a disc."""
    "in units of length squared"
    return 3.0 * radius ** 2
'''


def digest(tmp_path, text, name="disc.py"):
    (tmp_path / name).write_text(text)
    return digest_of({f"discs/{name}": tmp_path / name})


def test_comments_docstrings_and_format_do_not_count(tmp_path):
    assert digest(tmp_path, SAME) == digest(tmp_path, PLAIN)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace("3.0", "3.1"),
        PLAIN.replace("area", "disc_area"),
        PLAIN.replace("**", "*"),
        PLAIN.replace("(radius)", "(radius=1.0)"),
        PLAIN + "x = 'text'\n",
    ],
)
def test_code_counts(tmp_path, text):
    assert digest(tmp_path, text) != digest(tmp_path, PLAIN)


def test_names_and_data_count(tmp_path):
    (tmp_path / "disc.py").write_text(PLAIN)
    one, other = (digest_of({name: tmp_path / "disc.py"}) for name in ("a.py", "b.py"))
    assert one != other
    assert digest(tmp_path, "# 1", "w.json") != digest(tmp_path, "# 2", "w.json")


def test_what_belongs_to_it(monkeypatch):
    seen = []
    monkeypatch.setattr(code, "digest_of", lambda files: seen.extend(files) or "digest")
    code_digest.cache_clear()
    try:
        assert code_digest() == "digest"
    finally:
        code_digest.cache_clear()
    for name in (
        "foresight_env/games/costs.py",
        "agents/registry.py",
        "agents/learned/shipped/ppo.safetensors",
        "evaluation/metrics/trajectory.py",
        "evaluation/studies/benchmark.py",
        "evaluation/training/generation.py",
    ):
        assert name in seen
    for room in ("cli", "reports", "execution"):
        assert not any(name.startswith(f"evaluation/{room}/") for name in seen)


def test_other_processes_have_the_same():
    script = "from evaluation.execution.code import code_digest; print(code_digest())"
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert run.stdout.strip() == code_digest()
    assert len(code_digest()) == 16
