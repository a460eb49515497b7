// Derivatives of the dynamics with Pinocchio at the points of the Rust program: computeABADerivatives, computeRNEADerivatives and
// ComputeRNEASecondOrderDerivatives. Compares what the Rust program computed with what follows from them, and prints medians of the times.

#include "../cycle/chain.hpp"

#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea-second-order-derivatives.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <vector>

using Clock = std::chrono::steady_clock;
using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Points in a block, short enough that few blocks are interrupted, and rounds over all points.
constexpr size_t BLOCK = 32;
constexpr int ROUNDS = 100;

struct Point {
    Vector q, qd, u, w, mu, qdd, tau;
    // By rows tau, then qdd_U; by columns q, qd, u.
    Matrix first, hessian;
};

Matrix filled(const Matrix &upper) { return upper.selfadjointView<Eigen::Upper>(); }

// The same from the derivatives of the forward dynamics: tau is that for which qdd_A stays u.
Matrix first_by_aba(const pin::Model &model, pin::Data &data, const Point &p) {
    const int n = model.nv, n_a = int(p.u.size()), n_u = n - n_a;
    pin::computeABADerivatives(model, data, p.q, p.qd, p.tau);
    const Matrix inverse = filled(data.Minv);
    Matrix of_x(n, 2 * n);
    of_x << data.ddq_dq, data.ddq_dv;
    const Matrix inverse_A = inverse.topLeftCorner(n_a, n_a).inverse();
    Matrix first(n, 2 * n + n_a);
    first.topLeftCorner(n_a, 2 * n) = -inverse_A * of_x.topRows(n_a);
    first.topRightCorner(n_a, n_a) = inverse_A;
    const Matrix inverse_UA = inverse.bottomLeftCorner(n_u, n_a);
    first.bottomLeftCorner(n_u, 2 * n) = of_x.bottomRows(n_u) + inverse_UA * first.topLeftCorner(n_a, 2 * n);
    first.bottomRightCorner(n_u, n_a) = inverse_UA * inverse_A;
    return first;
}

// The same from the derivatives of the inverse dynamics.
Matrix first_by_rnea(const pin::Model &model, pin::Data &data, const Point &p) {
    const int n = model.nv, n_a = int(p.u.size()), n_u = n - n_a;
    pin::computeRNEADerivatives(model, data, p.q, p.qd, p.qdd);
    Matrix first(n, 2 * n + n_a);
    first.leftCols(n) = data.dtau_dq;
    first.middleCols(n, n) = data.dtau_dv;
    const auto M_AU = data.M.topRightCorner(n_a, n_u);
    first.topRightCorner(n_a, n_a) = data.M.topLeftCorner(n_a, n_a).selfadjointView<Eigen::Upper>();
    first.bottomRightCorner(n_u, n_a) = M_AU.transpose();
    const Matrix M_U = data.M.bottomRightCorner(n_u, n_u);
    first.bottomRows(n_u) = M_U.selfadjointView<Eigen::Upper>().llt().solve(-first.bottomRows(n_u)).eval();
    first.topRows(n_a).noalias() += M_AU * first.bottomRows(n_u);
    return first;
}

struct SecondOrder {
    pin::Data::Tensor3x dqdq, dvdv, dqdv, dadq;
    explicit SecondOrder(int n) : dqdq(n, n, n), dvdv(n, n, n), dqdv(n, n, n), dadq(n, n, n) {}
    void compute(const pin::Model &model, pin::Data &data, const Point &p) {
        for (auto *tensor : {&dqdq, &dvdv, &dqdv, &dadq})
            tensor->setZero();
        pin::ComputeRNEASecondOrderDerivatives(model, data, p.q, p.qd, p.qdd, dqdq, dvdv, dqdv, dadq);
    }
};

// The Hessian of w . qdd_U + mu . tau from the second derivatives of eta . r, r = M qdd + C qd + g, for constant eta.
Matrix hessian(const pin::Model &model, pin::Data &data, const Point &p, const Matrix &first, SecondOrder &second) {
    const int n = model.nv, n_a = int(p.u.size()), n_u = n - n_a;
    pin::computeRNEADerivatives(model, data, p.q, p.qd, p.qdd);
    const Matrix M = filled(data.M);
    Vector eta(n);
    eta << p.mu, -M.bottomRightCorner(n_u, n_u).llt().solve(p.w + M.bottomLeftCorner(n_u, n_a) * p.mu);
    second.compute(model, data, p);
    Matrix of_r = Matrix::Zero(3 * n, 3 * n);
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < n; ++k) {
                of_r(j, k) += eta[i] * second.dqdq(i, j, k);
                of_r(n + j, n + k) += eta[i] * second.dvdv(i, j, k);
                of_r(j, n + k) += eta[i] * second.dqdv(i, j, k);
                of_r(n + k, j) += eta[i] * second.dqdv(i, j, k);
                of_r(2 * n + j, k) += eta[i] * second.dadq(i, j, k);
                of_r(k, 2 * n + j) += eta[i] * second.dadq(i, j, k);
            }
    Matrix motion = Matrix::Zero(3 * n, 2 * n + n_a);
    motion.topLeftCorner(2 * n, 2 * n).setIdentity();
    motion.block(2 * n, 2 * n, n_a, n_a).setIdentity();
    motion.bottomRows(n_u) = first.bottomRows(n_u);
    return motion.transpose() * of_r * motion;
}

// Largest difference, relative to the largest entry.
double difference(const Matrix &a, const Matrix &b) { return (a - b).lpNorm<Eigen::Infinity>() / b.lpNorm<Eigen::Infinity>(); }

template <typename Work> void time(const char *name, const std::vector<Point> &points, Work work) {
    std::vector<double> us;
    for (int round = 0; round < ROUNDS; ++round)
        for (size_t first = 0; first + BLOCK <= points.size(); first += BLOCK) {
            const auto begin = Clock::now();
            for (size_t i = first; i < first + BLOCK; ++i)
                work(points[i]);
            us.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begin).count() / BLOCK);
        }
    std::nth_element(us.begin(), us.begin() + us.size() / 2, us.end());
    std::printf("%-50s %.3f us\n", name, us[us.size() / 2]);
}

int main(int argc, char **argv) {
    if (argc != 3) {
        std::fprintf(stderr, "error: expected CHAIN and POINTS\n");
        return 2;
    }
    const pin::Model model = read_chain(argv[1]);
    pin::Data data(model);
    std::ifstream file(argv[2], std::ios::binary);
    double sizes[2] = {};
    file.read(reinterpret_cast<char *>(sizes), sizeof sizes);
    const int n = int(sizes[0]), n_a = int(sizes[1]), n_u = n - n_a, nz = 2 * n + n_a;
    if (n != model.nv || n_a < 1 || n_a >= n) {
        std::fprintf(stderr, "error: expected points of the chain's %d joints, got %d joints, %d of them actuated\n", model.nv, n, n_a);
        return 2;
    }
    auto take = [&](int rows, int columns) {
        std::vector<double> row(rows * columns);
        file.read(reinterpret_cast<char *>(row.data()), row.size() * sizeof(double));
        return Matrix(Eigen::Map<Rows>(row.data(), rows, columns));
    };
    std::vector<Point> points;
    while (file.peek() != EOF) {
        Point p;
        p.q = take(n, 1);
        p.qd = take(n, 1);
        p.u = take(n_a, 1);
        p.w = take(n_u, 1);
        p.mu = take(n_a, 1);
        const Matrix qdd_U = take(n_u, 1);
        p.qdd.resize(n);
        p.qdd << p.u, qdd_U;
        p.tau = Vector::Zero(n);
        p.tau.head(n_a) = take(n_a, 1);
        p.first = take(n, nz);
        p.hessian = take(nz, nz);
        points.push_back(p);
    }
    if (points.empty()) {
        std::fprintf(stderr, "error: expected points, got none\n");
        return 2;
    }
    SecondOrder second(n);
    double aba = 0, rnea = 0, twice = 0;
    for (const auto &p : points) {
        const Matrix first = first_by_rnea(model, data, p);
        aba = std::max(aba, difference(first_by_aba(model, data, p), p.first));
        rnea = std::max(rnea, difference(first, p.first));
        twice = std::max(twice, difference(hessian(model, data, p, first, second), p.hessian));
    }
    std::printf("largest relative differences: %.1e by ABA, %.1e by RNEA, %.1e of the Hessian\n", aba, rnea, twice);
    time("computeABADerivatives", points, [&](const Point &p) { pin::computeABADerivatives(model, data, p.q, p.qd, p.tau); });
    double sum = 0;
    time("computeRNEADerivatives, A, B, d tau / dz", points, [&](const Point &p) { sum += first_by_rnea(model, data, p)(0, 0); });
    time("ComputeRNEASecondOrderDerivatives", points, [&](const Point &p) { second.compute(model, data, p); });
    std::printf("(%.3g)\n", sum);
    return std::max({aba, rnea, twice}) < 1e-9 ? 0 : 1;
}
