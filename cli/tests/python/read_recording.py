"""Reads a recording with the official MCAP reader and its ROS 2 decoder.

usage: read_recording.py RUN.mcap CYCLES [--cut]
CYCLES is how many cycles are in the file; with --cut, at least how many. Prints what it found; ends with 1 if something
is not as it should be.
"""

import struct
import sys

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

TOPICS = {"/upswing/cycle", "/upswing/step", "/upswing/plan", "/joint_states", "/tf", "/robot_description"}


def messages(file, cut):
    reader = (NonSeekingReader if cut else make_reader)(file, decoder_factories=[DecoderFactory()])
    try:
        # Not sorted: a file that was cut off has to be read as it comes.
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield channel.topic, message.log_time, decoded
    except (McapError, struct.error):
        if not cut:
            raise


def main():
    path, expected, cut = sys.argv[1], int(sys.argv[2]), "--cut" in sys.argv
    counts, previous, plans, steps = dict.fromkeys(TOPICS, 0), None, set(), 0
    with open(path, "rb") as file:
        for topic, log_time, m in messages(file, cut):
            counts[topic] += 1
            if topic == "/upswing/cycle":
                assert m.t_ns == log_time and len(m.q) == 9 and len(m.tau) == 7, m
                assert previous is None or m.seq == previous + 1, f"cycle {m.seq} after {previous}"
                previous = m.seq
            elif topic == "/upswing/step":
                steps += 1
                assert m.number == steps and len(m.q) == 9 and m.period_ns > 0, m
                assert m.plan_id == 0 or m.plan_id in plans, m
            elif topic == "/upswing/plan":
                assert len(m.x) == 101 * 18 and len(m.k) == 101 * 7 * 18 and m.t_f > 0
                plans.add(m.id)
            elif topic == "/tf":
                for t in m.transforms:
                    r = t.transform.rotation
                    assert abs(r.x**2 + r.y**2 + r.z**2 + r.w**2 - 1) < 1e-9, t
                links = {t.child_frame_id for t in m.transforms}
                assert {"base", "link_7", "rod"} <= links, links
            elif topic == "/joint_states":
                assert len(m.name) == len(m.position) == len(m.velocity) == len(m.effort) == 9, m
            else:
                assert "<robot" in m.data
    print(counts)
    cycles = counts["/upswing/cycle"]
    assert cycles >= expected if cut else cycles == expected, f"{cycles} cycles, expected {expected}"
    assert all(counts.values()), counts
    if not cut:
        with open(path, "rb") as file:
            reader = make_reader(file)
            names = {a.name for a in reader.iter_attachments()}
            assert {"robot.urdf", "daemon.toml"} <= names, names
            assert any(m.name == "upswing" for m in reader.iter_metadata())


main()
