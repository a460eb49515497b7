"""Fixtures of the tests, which run against the installed wheel. `UPSWING` is the path of the command line to compare with."""

import json
import os
import subprocess

import pytest
import upswing

ARM_START_DEG = [-15.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0]


@pytest.fixture(scope="session")
def arm():
    return upswing.System.load("iiwa-pendulum")


@pytest.fixture(scope="session")
def cart():
    return upswing.System.load("cart-pole")


@pytest.fixture(scope="session")
def arm_planner(arm):
    return upswing.Planner(arm)


@pytest.fixture(scope="session")
def command():
    """Runs the command line and returns its JSON; the exit code has to be 0 or 1."""
    program = os.environ.get("UPSWING")
    if not program:
        pytest.skip("UPSWING does not name the command line")

    def run(*arguments, stdin=None):
        done = subprocess.run([program, *arguments], input=stdin, capture_output=True, text=True)
        assert done.returncode in (0, 1), done.stderr
        return json.loads(done.stdout)

    run.error = lambda *arguments: subprocess.run([program, *arguments], capture_output=True, text=True).stderr
    return run
