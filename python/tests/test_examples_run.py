"""The examples print what they announce, and those of the documentation run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    "name, arguments, expected",
    [
        ("own_controller", ["1"], ["| ours | nominal | 1 of 1 |", "PD controller | everyday | 0 of 1 |"]),
        ("crane", ["crane.json"], ["crane.json"]),
        ("paper", ["2"], ["offline optimisation: solved", "closed loop: success True", "2 of 2 random starts planned"]),
    ],
)
def test_example(name, arguments, expected, tmp_path):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for text in expected:
        assert text in done.stdout


def test_documentation(tmp_path):
    page = EXAMPLES.parents[1] / "docs" / "python.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    script = "\n".join(blocks).replace("samples=20", "samples=1")
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "| ours | everyday | 1 of 1 |" in done.stdout and "| mine | nominal | 1 of 1 |" in done.stdout
