"""Writes a recording of upswing as a bag of ROS 2, which `ros2 bag` plays: positions, velocities and torques of the joints as
sensor_msgs/msg/JointState on /joint_states, and the reference on /joint_states_desired. Needs no ROS.

    pip install ./python rosbags
    python python/examples/ros2_bag.py RUN.mcap BAG [EVERY]

`BAG` is the folder to write, with metadata.yaml and an MCAP file. `EVERY`: only each so many cycles; 8 without, which is 1 kHz.
"""

import sys

import numpy as np
import upswing
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore


def write(recording, bag, every=8):
    """Writes the cycles of a recording to the folder `bag`; returns the number of messages of each topic."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    JointState = types.types[kind]
    Header, Time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    cycles = range(0, len(recording), every)
    # JointState has one effort for each joint; those without a motor have none.
    effort = np.zeros_like(recording.q)
    effort[:, [recording.joints.index(joint) for joint in recording.actuated]] = recording.tau_measured
    topics = {
        "/joint_states": (recording.q, recording.qd, effort),
        "/joint_states_desired": (recording.q_d, recording.qd_d, np.full_like(effort, np.nan)),
    }
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=types) for topic in topics}
        for i in cycles:
            t_ns = int(recording.t_ns[i])
            header = Header(stamp=Time(sec=t_ns // 10**9, nanosec=t_ns % 10**9), frame_id="")
            for topic, (q, qd, tau) in topics.items():
                message = JointState(header=header, name=recording.joints, position=q[i], velocity=qd[i], effort=tau[i])
                writer.write(connections[topic], t_ns, types.serialize_cdr(message, kind))
    return len(cycles)


def main():
    path, bag, *every = sys.argv[1:]
    messages = write(upswing.Recording.read(path), bag, *map(int, every))
    print(f"{bag}: {messages} messages of each topic")


if __name__ == "__main__":
    main()
