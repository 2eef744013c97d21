// The module taxinet_ros.core.camera.pixels: per-pixel operations. Documented in pixels.pyi.

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "air.hpp"
#include "ground.hpp"
#include "light.hpp"
#include "network.hpp"
#include "outline.hpp"
#include "plan.hpp"
#include "pose.hpp"
#include "reduction.hpp"
#include "shadow.hpp"
#include "skyline.hpp"
#include "vectors.hpp"
#include "warp.hpp"

namespace py = pybind11;
using namespace pixels;

namespace {

Axis axis(const std::array<double, 3> &ruler, const std::array<float, 4> &limits) {
    return {ruler[0], ruler[1], ruler[2], limits[0], limits[1], limits[2], limits[3]};
}

Tile tile(const std::array<float, 4> &numbers) {
    return {numbers[0], numbers[1], numbers[2], numbers[3]};
}

Floats array(const std::vector<float> &numbers) {
    return Floats(static_cast<py::ssize_t>(numbers.size()), numbers.data());
}

py::tuple arrays(const Parts &parts) {
    return py::make_tuple(array(parts.by_column), array(parts.by_row));
}

// Instruction-set extensions used on this processor; the output does not depend on them.
std::vector<std::string> instruction_sets() {
    std::vector<std::string> taken;
#if defined(WITH_CLONES)
    if (__builtin_cpu_supports("x86-64-v4")) {
        taken.emplace_back("x86-64-v4");
    } else if (__builtin_cpu_supports("x86-64-v3")) {
        taken.emplace_back("x86-64-v3");
    }
#endif
#if defined(WITH_VECTORS)
    if (__builtin_cpu_supports("avx2")) {
        taken.emplace_back("avx2");
    }
    if (__builtin_cpu_supports("avx512bw")) {
        taken.emplace_back("avx512bw");
    }
    if (__builtin_cpu_supports("avx512vbmi")) {
        taken.emplace_back("avx512vbmi");
    }
#endif
    return taken;
}

}  // namespace

PYBIND11_MODULE(pixels, module) {
    py::class_<Sight>(module, "Sight")
        .def(py::init<const Doubles &, const Doubles &, int, int>())
        .def("fall", [](const Sight &sight) { return arrays(sight.fall()); })
        .def("density", [](const Sight &sight, int axis, double texel_m) {
            require(axis == 0 || axis == 1, "the ground has the axes 0 and 1");
            return arrays(sight.density(axis, texel_m));
        })
        .def("coordinate", [](const Sight &sight, int axis, double unit_m, double origin) {
            require(axis == 0 || axis == 1, "the ground has the axes 0 and 1");
            const Form form = sight.coordinate(axis, unit_m, origin);
            return py::make_tuple(form[0], form[1], form[2]);
        })
        .def("first_row_nearer_than", &Sight::first_row_nearer_than);
    py::class_<Ruler>(module, "Ruler")
        .def(py::init([](float least_fall, const std::array<double, 3> &along,
                         const std::array<float, 4> &along_limits,
                         const std::array<double, 3> &across,
                         const std::array<float, 4> &across_limits,
                         const std::array<float, 4> &bend, int bend_levels,
                         const std::array<float, 4> &grain_along,
                         const std::array<float, 4> &grain_across, double tile_m,
                         double grain_reach_m) {
                 return Ruler{least_fall,
                              axis(along, along_limits),
                              axis(across, across_limits),
                              Bend{bend[0], bend[1], bend[2], bend[3], bend_levels},
                              tile(grain_along),
                              tile(grain_across),
                              tile_m,
                              grain_reach_m};
             }),
             py::kw_only(), py::arg("least_fall"), py::arg("along"), py::arg("along_limits"),
             py::arg("across"), py::arg("across_limits"), py::arg("bend"), py::arg("bend_levels"),
             py::arg("grain_along"), py::arg("grain_across"), py::arg("tile_m"),
             py::arg("grain_reach_m"));
    py::class_<Ground>(module, "Ground")
        .def(py::init<Bytes, Bytes, const Floats &, const Ruler &, const std::array<int, 3> &, float>(),
             py::arg("atlas").noconvert(), py::arg("grain").noconvert(), py::arg("dither"),
             py::arg("ruler"), py::arg("neutral"), py::arg("scale"))
        .def("sample", &Ground::sample, py::arg("out").noconvert(), py::arg("sight"),
             py::arg("hidden"));
    py::class_<Air>(module, "Air")
        .def(py::init([](double visibility_m, double film, double spray,
                         const std::array<double, kChannels> &sky_low,
                         const std::array<double, kChannels> &sky_high, double glare,
                         double sun_yaw_rad, double glare_width_rad) {
                 return Air{visibility_m, film,        spray,          sky_low, sky_high,
                            glare,        sun_yaw_rad, glare_width_rad};
             }),
             py::kw_only(), py::arg("visibility_m"), py::arg("film"), py::arg("spray"),
             py::arg("sky_low"), py::arg("sky_high"), py::arg("glare"), py::arg("sun_yaw_rad"),
             py::arg("glare_width_rad"))
        .def("veil", &Air::veil)
        .def("shine", &Air::shine);
    py::class_<Panorama>(module, "Panorama")
        .def(py::init<Bytes, double, double, double, int>(), py::arg("codes").noconvert(),
             py::arg("lowest_rad"), py::arg("step_rad"), py::arg("end_tan"), py::arg("spacing_px"))
        .def("lay_over", &Panorama::lay_over, py::arg("picture").noconvert(), py::arg("rays"));
    py::class_<Reduction>(module, "Reduction")
        .def(py::init<int, int, std::vector<std::pair<int, int>>, int>())
        .def("reduce", &Reduction::reduce);
    py::class_<Warp>(module, "Warp")
        .def(py::init<int, int, const Whole &, int>(), py::arg("height"), py::arg("width"),
             py::arg("places").noconvert(), py::arg("unseen"))
        .def("look", &Warp::look, py::arg("frame").noconvert());
    py::class_<Convolution>(module, "Convolution")
        .def(py::init<const Floats &, const Floats &, int, int, bool>(),
             py::arg("weights").noconvert(), py::arg("biases").noconvert(), py::kw_only(),
             py::arg("stride"), py::arg("padding"), py::arg("rectified"));
    py::class_<Network>(module, "Network")
        .def(py::init<int, int, std::vector<Convolution>>(), py::arg("height"), py::arg("width"),
             py::arg("layers"))
        .def("infer", &Network::infer, py::arg("pictures").noconvert());
    py::class_<Shadow>(module, "Shadow")
        .def(py::init<const Doubles &, std::vector<int>, const Point &, const Doubles &,
                      const std::array<int, 2> &, double, double, int>())
        .def("outlines", &Shadow::outlines);
    py::class_<Pinhole>(module, "Pinhole")
        .def(py::init<const Doubles &, const std::array<int, 2> &, double, double>())
        .def("cover", &Pinhole::cover)
        .def("faces", &Pinhole::faces);
    module.def("gap", &gap);
    module.def("pose", &pose);
    // noconvert: output arrays must not be converted copies, and large inputs must not be copied.
    module.def("tint_rows", &tint_rows, py::arg("picture").noconvert(), py::arg("shares"));
    module.def("tint_masked", &tint_masked, py::arg("picture").noconvert(),
               py::arg("mask").noconvert(), py::arg("depth"));
    module.def("average", &average, py::arg("canvas").noconvert(), py::arg("picture").noconvert());
    module.def("blend_masked", &blend_masked, py::arg("picture").noconvert(),
               py::arg("mask").noconvert(), py::arg("paint"), py::arg("opacity"));
    module.def("develop", &develop, py::arg("ground").noconvert(), py::arg("curve"),
               py::arg("kept"), py::arg("added"), py::arg("picture").noconvert());
    module.def("lay_over", &lay_over, py::arg("picture").noconvert(), py::arg("kept"),
               py::arg("added"));
    module.def("add_shine", &add_shine, py::arg("picture").noconvert(), py::arg("by_row"),
               py::arg("by_column"), py::arg("tint"));
    module.def("instruction_sets", &instruction_sets);
}
