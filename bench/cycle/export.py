"""Writes the chain of a URDF as Pinocchio reads it, one joint per line: axis (0 x, 1 y, 2 z), rotation (9, by rows) and
translation of its frame, then mass, centre of mass and inertia about it (xx, xy, yy, xz, yz, zz).

The headers of the URDF library are not on PyPI, so the C++ program cannot read it itself.
"""

import sys

import pinocchio as pin

urdf, chain = sys.argv[1:]
model = pin.buildModelFromUrdf(urdf)
with open(chain, "w") as file:
    for joint, placement, inertia in list(zip(model.joints, model.jointPlacements, model.inertias))[1:]:
        axis = ["JointModelRX", "JointModelRY", "JointModelRZ"].index(joint.shortname())
        about_com = pin.Symmetric3(inertia.inertia).data
        numbers = [*placement.rotation.flatten(), *placement.translation, inertia.mass, *inertia.lever, *about_com]
        print(axis, *(repr(float(number)) for number in numbers), file=file)
