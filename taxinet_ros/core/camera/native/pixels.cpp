// The module as one translation unit: reading pybind11's headers takes a compiler longer than all
// that is said here, and each unit of its own would read them anew.

#include "air.cpp"
#include "ground.cpp"
#include "light.cpp"
#include "module.cpp"
#include "outline.cpp"
#include "product.cpp"
#include "reduction.cpp"
#include "sight.cpp"
#include "skyline.cpp"
