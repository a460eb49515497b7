// The torque law (24) with Pinocchio: crba + nonLinearEffects + a solve with M_UU, at the states of the Rust program.
// Prints the largest difference of the torques and the percentiles of the time per call.

#include "chain.hpp"

#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <vector>

using Clock = std::chrono::steady_clock;

constexpr int MOST_JOINTS = 16;
constexpr int ROUNDS = 4, BLOCKS = 2000;

// Sizes at run time, memory inline.
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, MOST_JOINTS, 1>;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, MOST_JOINTS, MOST_JOINTS>;

struct Sample {
    Eigen::VectorXd q, qd;
    Vector u, tau;
};

Vector torque(const pin::Model &model, pin::Data &data, const Sample &s) {
    const auto n_a = s.u.size(), n_u = model.nv - n_a;
    pin::crba(model, data, s.q, pin::Convention::WORLD);
    pin::nonLinearEffects(model, data, s.q, s.qd);
    const auto &M = data.M; // the upper triangle is filled
    const auto M_AU = M.topRightCorner(n_a, n_u);
    const Matrix M_U = M.bottomRightCorner(n_u, n_u);
    const Vector qdd_U = M_U.selfadjointView<Eigen::Upper>().llt().solve(-(M_AU.transpose() * s.u + data.nle.tail(n_u)));
    Vector tau = data.nle.head(n_a) + M_AU * qdd_U;
    tau.noalias() += M.topLeftCorner(n_a, n_a).selfadjointView<Eigen::Upper>() * s.u;
    return tau;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        std::fprintf(stderr, "error: expected CHAIN and STATES\n");
        return 2;
    }
    const pin::Model model = read_chain(argv[1]);
    pin::Data data(model);
    std::vector<Sample> samples;
    std::ifstream file(argv[2], std::ios::binary);
    // Numbers of joints and of actuated joints, then the samples.
    double sizes[2] = {};
    file.read(reinterpret_cast<char *>(sizes), sizeof sizes);
    const int n = int(sizes[0]), n_a = int(sizes[1]);
    if (n != model.nv || n > MOST_JOINTS || n_a < 1 || n_a >= n) {
        std::fprintf(stderr, "error: expected states of the chain's %d joints, got %d joints, %d of them actuated\n", model.nv, n,
                     n_a);
        return 2;
    }
    std::vector<double> row(2 * n + 2 * n_a);
    while (file.read(reinterpret_cast<char *>(row.data()), row.size() * sizeof(double))) {
        Sample s;
        s.q = Eigen::Map<Eigen::VectorXd>(row.data(), n);
        s.qd = Eigen::Map<Eigen::VectorXd>(row.data() + n, n);
        s.u = Eigen::Map<Eigen::VectorXd>(row.data() + 2 * n, n_a);
        s.tau = Eigen::Map<Eigen::VectorXd>(row.data() + 2 * n + n_a, n_a);
        samples.push_back(s);
    }
    if (samples.empty()) {
        std::fprintf(stderr, "error: expected states, got none\n");
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
