#include "skyline.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace pixels {

std::pair<Floats, Floats> on_panorama(const Doubles &rays, const Doubles &columns, int rows,
                                      const std::array<double, 4> &measures) {
    require(rays.ndim() == 2 && rays.shape(0) == 3 && rays.shape(1) == 3 && columns.size() > 0 &&
                rows > 0,
            "directions are of rays (3, 3), some columns and some rows");
    const auto [per_radian, lowest_rad, step_rad, count] = measures;
    const auto along = [&rays](int axis, double u, double v) {
        return rays.at(axis, 0) * u + rays.at(axis, 1) * v + rays.at(axis, 2);
    };
    // Measured from the view's middle, yaw has no jump inside the picture.
    const py::ssize_t width = columns.size();
    const double middle = columns.data()[width / 2];
    const double cos = along(0, middle, 0), sin = along(1, middle, 0);
    const double north = std::atan2(sin, cos) + std::numbers::pi;
    Floats across({static_cast<py::ssize_t>(rows), width});
    Floats up({static_cast<py::ssize_t>(rows), width});
    for (int v = 0; v < rows; ++v) {
        for (py::ssize_t i = 0; i < width; ++i) {
            const double u = columns.data()[i];
            const double x = along(0, u, v), y = along(1, u, v), z = along(2, u, v);
            const double aside = std::atan2(cos * y - sin * x, cos * x + sin * y);
            const double row = (std::atan2(z, std::hypot(x, y)) - lowest_rad) / step_rad;
            *across.mutable_data(v, i) = static_cast<float>((north + aside) * per_radian);
            *up.mutable_data(v, i) = static_cast<float>(std::clamp(row, 0.0, count - 1));
        }
    }
    return {across, up};
}

}  // namespace pixels
