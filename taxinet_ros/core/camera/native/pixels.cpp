// The module as one translation unit: compiling pybind11's headers takes longer than all code here,
// and separate units would each compile them again.

#include "air.cpp"
#include "ground.cpp"
#include "light.cpp"
#include "luma.cpp"
#include "module.cpp"
#include "network.cpp"
#include "outline.cpp"
#include "plan.cpp"
#include "pose.cpp"
#include "product.cpp"
#include "reduction.cpp"
#include "shadow.cpp"
#include "sight.cpp"
#include "skyline.cpp"
#include "warp.cpp"
