"""The examples print what they announce, and those of the documentation run; notebooks are run as scripts, in a short setting."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import upswing

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    "name, arguments, expected",
    [
        ("own_controller", ["1"], ["| ours | nominal | 1 of 1 |", "PD controller | everyday | 0 of 1 |"]),
        ("own_machine", [], ["robot.toml", "solved, t_F", "closed loop: success True []"]),
        ("crane", ["crane.json"], ["crane.json"]),
        ("realaigym_uptime", ["pendubot"], ["pendubot: ", "s of 60 s above the line", "plans tried"]),
        ("paper", ["2"], ["offline optimisation: solved", "closed loop: success True", "2 of 2 random starts planned"]),
    ],
)
def test_example(name, arguments, expected, tmp_path):
    pytest.importorskip("matplotlib")
    if name == "own_machine" and "UPSWING" not in os.environ:
        pytest.skip("UPSWING does not name the command line")
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={**os.environ, "MPLBACKEND": "svg"},
    )
    assert done.returncode == 0, done.stderr
    for text in expected:
        assert text in done.stdout


def test_every_notebook_is_a_page_of_the_site():
    notebooks = [path.stem for path in EXAMPLES.glob("*.py") if path.read_text().startswith("# %% [markdown]")]
    pages = EXAMPLES.parents[1] / "docs" / "notebooks"
    assert sorted(notebooks) == sorted(path.stem for path in pages.glob("*.md"))
    for name in notebooks:
        page = (pages / f"{name}.md").read_text(encoding="utf-8")
        # The pages have the code of the notebooks as they are.
        cells = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8").split("# %%")[1:]
        code = [cell.partition("\n")[2].strip("\n") for cell in cells if not cell.startswith(" [markdown]")]
        assert code and all(f"```python\n{cell}\n```" in page for cell in code), f"run docs/notebooks/make {name}"
        assert all((pages / picture).exists() for picture in re.findall(r"\]\(([\w-]+\.svg)\)", page))


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_bag_of_ros_2_has_the_recording(cart, tmp_path):
    pytest.importorskip("rosbags")
    mcap_reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    run = upswing.ClosedLoop(upswing.Planner(cart), [0.0]).run(2.0)
    run.save(tmp_path / "run.mcap")
    arguments = [str(EXAMPLES / "ros2_bag.py"), str(tmp_path / "run.mcap"), str(tmp_path / "bag"), "16"]
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    recording = upswing.Recording.of(run)
    expected = range(0, len(recording), 16)

    # As `ros2 bag` does: metadata.yaml, and the messages by their type.
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "bag"]) as reader:
        assert set(reader.topics) == {"/joint_states", "/joint_states_desired"}
        assert all(topic.msgcount == len(expected) for topic in reader.topics.values())
    # With another library, from the MCAP file alone: it has the schemas.
    [file] = (tmp_path / "bag").glob("*.mcap")
    with open(file, "rb") as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        assert reader.get_summary() is not None
        kinds = {(schema.name, schema.encoding) for schema in reader.get_summary().schemas.values()}
        assert kinds == {("sensor_msgs/msg/JointState", "ros2msg")}
        messages = [message for *_, message in reader.iter_decoded_messages(topics=["/joint_states"])]
    motor = recording.joints.index(recording.actuated[0])
    for i, message in zip(expected, messages):
        assert list(message.name) == recording.joints
        assert list(message.position) == recording.q[i].tolist() and list(message.velocity) == recording.qd[i].tolist()
        assert message.effort[motor] == recording.tau_measured[i][0]
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == recording.t_ns[i]
    assert len(messages) == len(expected)


def test_a_plan_is_played_in_mujoco_without_a_window(arm, arm_planner, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    trajectory = arm_planner.replan(np.deg2rad([0, 0, 0, -90, 0, 0, 0])).trajectory
    upswing.export(trajectory, tmp_path / "plan.json")
    (tmp_path / "robot.urdf").write_text(arm.urdf)
    files = [str(tmp_path / "robot.urdf"), str(tmp_path / "plan.json")]
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "mujoco_viewer.py"), *files, "--headless"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "frames, last body from" in done.stdout
    viewer = load("mujoco_viewer")
    model = viewer.load(arm.urdf)
    data = mujoco.MjData(model)
    frames = viewer.play(model, data, {"joints": arm.joints, "t_f": trajectory.t_f, "t": trajectory.t, "q": trajectory.x[:, : len(arm.joints)]})
    # The frame of the last joint is where the model of upswing has it.
    end = arm.model.forward_kinematics(trajectory.x[-1, : len(arm.joints)])[-1, :3, 3]
    body = model.joint(arm.joints[-1]).bodyid[0]
    assert np.allclose(data.xpos[body], end, atol=1e-9)
    assert len(frames) > 60 * trajectory.t_f and model.ngeom > len(arm.joints)


def test_documentation(tmp_path):
    page = EXAMPLES.parents[1] / "docs" / "python.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    script = "\n".join(blocks).replace("samples=20", "samples=1")
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "| ours | everyday | 1 of 1 |" in done.stdout and "| mine | nominal | 1 of 1 |" in done.stdout
