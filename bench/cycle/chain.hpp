// Reads the chain that export.py writes.

#pragma once

#include <pinocchio/multibody.hpp>

#include <fstream>
#include <string>

namespace pin = pinocchio;

inline pin::Model read_chain(const char *path) {
    pin::Model model;
    std::ifstream file(path);
    int axis;
    while (file >> axis) {
        double v[12], mass, lever[3], moment[6];
        for (double &number : v)
            file >> number;
        file >> mass;
        for (double &number : lever)
            file >> number;
        for (double &number : moment)
            file >> number;
        const pin::SE3 placement(Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(v), Eigen::Map<Eigen::Vector3d>(v + 9));
        const pin::JointIndex parent = model.njoints - 1;
        const std::string name = "joint_" + std::to_string(model.njoints);
        const pin::JointModel joint = axis == 0   ? pin::JointModel(pin::JointModelRX())
                                      : axis == 1 ? pin::JointModel(pin::JointModelRY())
                                                  : pin::JointModel(pin::JointModelRZ());
        const auto index = model.addJoint(parent, joint, placement, name);
        model.appendBodyToJoint(index, pin::Inertia(mass, Eigen::Map<Eigen::Vector3d>(lever),
                                                    pin::Symmetric3(Eigen::Map<Eigen::Matrix<double, 6, 1>>(moment))));
    }
    return model;
}
