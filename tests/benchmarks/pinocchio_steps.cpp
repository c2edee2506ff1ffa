// pinocchio_steps COUNT < NUMBERS: classical Runge-Kutta steps of 1 ms of a free-flying chain with
// pinocchio::aba. Prints the acceleration at the start (6 + n, in the base's axes) and the time per
// step [us], best of seven runs of COUNT steps.
// NUMBERS: n; base; n times (1 for revolute or 0 for prismatic, rotation (9, by rows), translation
// (3), body); q (7 + n); v (6 + n). A body is mass, centre of mass (3), inertia about it (9).
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/multibody.hpp>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>

using Vector = Eigen::VectorXd;

static double number()
{
    double value;
    if (!(std::cin >> value))
        std::exit(3);
    return value;
}

template <class Matrix> static void read(Matrix &m)
{
    for (int i = 0; i < m.rows(); i++)
        for (int k = 0; k < m.cols(); k++)
            m(i, k) = number();
}

static pinocchio::Inertia body()
{
    double mass = number();
    Eigen::Vector3d centre;
    Eigen::Matrix3d inertia;
    read(centre);
    read(inertia);
    return pinocchio::Inertia(mass, centre, inertia);
}

int main(int argc, char **argv)
{
    if (argc != 2)
        return 2;
    pinocchio::Model model;
    model.gravity.setZero();
    const int n = (int)number(), nv = 6 + n, nq = 7 + n;
    auto parent =
        model.addJoint(0, pinocchio::JointModelFreeFlyer(), pinocchio::SE3::Identity(), "base");
    model.appendBodyToJoint(parent, body(), pinocchio::SE3::Identity());
    for (int i = 0; i < n; i++) {
        bool revolute = number() != 0;
        Eigen::Matrix3d rotation;
        Eigen::Vector3d translation;
        read(rotation);
        read(translation);
        pinocchio::SE3 place(rotation, translation);
        std::string name = "joint_" + std::to_string(i);
        parent = revolute ? model.addJoint(parent, pinocchio::JointModelRZ(), place, name)
                          : model.addJoint(parent, pinocchio::JointModelPZ(), place, name);
        model.appendBodyToJoint(parent, body(), pinocchio::SE3::Identity());
    }
    pinocchio::Data data(model);
    Vector start_q(nq), start_v(nv), effort = Vector::Zero(nv);
    read(start_q);
    read(start_v);
    const Vector first = pinocchio::aba(model, data, start_q, start_v, effort);
    for (int i = 0; i < nv; i++)
        std::printf("%.17g ", first[i]);

    Vector q, v, q_stage(nq), q_slope(nq), q_sum(nq), v_stage(nv), v_sum(nv);
    // Rates of the coordinates; the rates of the velocities are in `data.ddq`.
    auto slopes = [&](const Vector &at_q, const Vector &at_v) {
        pinocchio::aba(model, data, at_q, at_v, effort);
        Eigen::Quaterniond orientation(at_q[6], at_q[3], at_q[4], at_q[5]);
        q_slope.head<3>() = orientation._transformVector(at_v.head<3>());
        q_slope.segment<4>(3) =
            0.5 * (orientation * Eigen::Quaterniond(0, at_v[3], at_v[4], at_v[5])).coeffs();
        q_slope.tail(n) = at_v.tail(n);
    };
    auto stage = [&](double h) {
        q_stage.noalias() = q + h * q_slope;
        q_stage.segment<4>(3).normalize();
        v_stage.noalias() = v + h * data.ddq;
        slopes(q_stage, v_stage);
    };
    const double h = 1e-3;
    const int count = std::atoi(argv[1]);
    double best = 1e9;
    for (int run = 0; run < 7; run++) {
        q = start_q;
        v = start_v;
        auto start = std::chrono::steady_clock::now();
        for (int k = 0; k < count; k++) {
            slopes(q, v);
            q_sum = q_slope;
            v_sum = data.ddq;
            stage(0.5 * h);
            q_sum += 2.0 * q_slope;
            v_sum += 2.0 * data.ddq;
            stage(0.5 * h);
            q_sum += 2.0 * q_slope;
            v_sum += 2.0 * data.ddq;
            stage(h);
            q += h / 6.0 * (q_sum + q_slope);
            v += h / 6.0 * (v_sum + data.ddq);
            q.segment<4>(3).normalize();
        }
        std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - start;
        best = std::min(best, took.count() / count);
    }
    std::printf("%.4f %.17g\n", best, q.tail(n).sum());
    return 0;
}
