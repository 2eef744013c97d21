#include "pose.hpp"

#include <cmath>
#include <cstring>

namespace pixels {
namespace {

Doubles array_of(const Matrix &matrix) {
    Doubles array({3, 3});
    std::memcpy(array.mutable_data(), matrix.data(), sizeof matrix);
    return array;
}

// As rotation() of camera_model.py.
Matrix rotation(double roll, double pitch, double yaw) {
    const double cr = std::cos(roll), sr = std::sin(roll);
    const double cp = std::cos(pitch), sp = std::sin(pitch);
    const double cy = std::cos(yaw), sy = std::sin(yaw);
    return {{{cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr},
             {sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr},
             {-sp, cp * sr, cp * cr}}};
}

Matrix transposed(const Matrix &matrix) {
    Matrix found;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            found[i][j] = matrix[j][i];
        }
    }
    return found;
}

}  // namespace

Matrix product(const Matrix &a, const Matrix &b) {
    Matrix found;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            found[i][j] =
                std::fma(a[i][2], b[2][j], std::fma(a[i][1], b[1][j], a[i][0] * b[0][j]));
        }
    }
    return found;
}

Point product(const Matrix &a, const Point &b) {
    Point found;
    for (int i = 0; i < 3; ++i) {
        found[i] = std::fma(a[i][2], b[2], std::fma(a[i][0], b[0], a[i][1] * b[1]));
    }
    return found;
}

std::tuple<Doubles, Doubles, Doubles> pose(const std::array<double, 6> &numbers,
                                           const Doubles &body_to_optical, const Point &offset) {
    const Matrix body = rotation(numbers[3], numbers[4], numbers[5]);
    const Point aside = product(body, offset);
    Doubles place(3);
    for (int i = 0; i < 3; ++i) {
        *place.mutable_data(i) = numbers[i] + aside[i];
    }
    const Matrix optical = matrix_of(body_to_optical, "a rotation is (3, 3)");
    return {array_of(body), array_of(product(optical, transposed(body))), place};
}

}  // namespace pixels
