// The torque law (24) with Pinocchio: crba + nonLinearEffects + a 2x2 solve, at the states of the Rust program.
// Prints the largest difference of the torques and the percentiles of the time per call.

#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

namespace pin = pinocchio;
using Clock = std::chrono::steady_clock;

constexpr int NQ = 9, NU = 7, N_U = 2, ROW = 2 * NQ + 2 * NU;
constexpr int ROUNDS = 4, BLOCKS = 2000;

struct Sample {
    Eigen::VectorXd q, qd;
    Eigen::Matrix<double, NU, 1> u, tau;
};

Eigen::Matrix<double, NU, 1> torque(const pin::Model &model, pin::Data &data, const Sample &s) {
    pin::crba(model, data, s.q, pin::Convention::WORLD);
    pin::nonLinearEffects(model, data, s.q, s.qd);
    const auto &M = data.M; // the upper triangle is filled
    const auto M_AU = M.topRightCorner<NU, N_U>();
    Eigen::Matrix2d M_U = M.bottomRightCorner<N_U, N_U>();
    M_U(1, 0) = M_U(0, 1);
    const Eigen::Vector2d qdd_U = -M_U.inverse() * (M_AU.transpose() * s.u + data.nle.tail<N_U>());
    Eigen::Matrix<double, NU, 1> tau = data.nle.head<NU>() + M_AU * qdd_U;
    tau.noalias() += M.topLeftCorner<NU, NU>().selfadjointView<Eigen::Upper>() * s.u;
    return tau;
}

// The chain that export.py wrote.
pin::Model read_model(const char *path) {
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

int main(int argc, char **argv) {
    if (argc != 3) {
        std::fprintf(stderr, "error: expected CHAIN and STATES\n");
        return 2;
    }
    const pin::Model model = read_model(argv[1]);
    pin::Data data(model);
    std::vector<Sample> samples;
    std::ifstream file(argv[2], std::ios::binary);
    double row[ROW];
    while (file.read(reinterpret_cast<char *>(row), sizeof row)) {
        Sample s;
        s.q = Eigen::Map<Eigen::VectorXd>(row, NQ);
        s.qd = Eigen::Map<Eigen::VectorXd>(row + NQ, NQ);
        s.u = Eigen::Map<Eigen::Matrix<double, NU, 1>>(row + 2 * NQ);
        s.tau = Eigen::Map<Eigen::Matrix<double, NU, 1>>(row + 2 * NQ + NU);
        samples.push_back(s);
    }
    if (samples.empty() || model.nv != NQ) {
        std::fprintf(stderr, "error: expected states and a chain of %d joints, got %zu states and %d joints\n", NQ,
                     samples.size(), model.nv);
        return 2;
    }
    double difference = 0, sum = 0;
    for (const auto &s : samples)
        difference = std::max(difference, (torque(model, data, s) - s.tau).lpNorm<Eigen::Infinity>());
    std::vector<double> us;
    for (int block = 0; block < BLOCKS; ++block) {
        const auto begin = Clock::now();
        for (int round = 0; round < ROUNDS; ++round)
            for (const auto &s : samples)
                sum += torque(model, data, s)[0];
        const double time = std::chrono::duration<double, std::micro>(Clock::now() - begin).count();
        us.push_back(time / (ROUNDS * samples.size()));
    }
    std::sort(us.begin(), us.end());
    auto at = [&](double share) { return us[std::min(size_t(share * us.size()), us.size() - 1)]; };
    std::printf("%-28s p50 %.3f us, p99 %.3f us, p99.9 %.3f us, max %.3f us (%zu samples; largest difference %.1e N m, "
                "checksum %.3g)\n",
                "torque law, Pinocchio", at(0.5), at(0.99), at(0.999), at(1), us.size(), difference, sum);
    return difference < 1e-9 ? 0 : 1;
}
