"""The examples print what they announce."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    "name, arguments, expected",
    [
        ("own_controller", ["1"], ["nominal: ours 1 of 1", "PD 0 of 1"]),
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
