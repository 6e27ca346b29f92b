"""The word check of `make lint`: prose is found, code is not."""

from pathlib import Path

import pytest

from tests.support.plain_words import check, read_words

PYTHON = '''"""What is solved, {word}."""
{word} = ["{word}", "`{word}` is code"]
# {word}
print(f"{{{word}}} is a value", "in a {word} text")
'''
MARKDOWN = """# A {word}
```
a {word} in code
```
"""


@pytest.mark.parametrize("word", ["nobody", "beside", "told", "anew"])
def test_words_are_found_in_prose_alone(word):
    words = read_words()
    found = check(Path("a.py"), PYTHON.format(word=word), words)
    assert sorted((f.line, f.word) for f in found) == [(1, "What"), (1, word), (3, word), (4, word)]
    found = check(Path("a.md"), MARKDOWN.format(word=word), words)
    assert [(f.line, f.word) for f in found] == [(1, word)]


def test_plain_prose_has_none():
    text = '"""Return the residual; `told` is code, distances are 2 m apart."""\n'
    assert check(Path("a.py"), text, read_words()) == []
