// Definitions for processor-specific code, within `#if defined(WITH_VECTORS)`.

#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(PLAIN)
#define WITH_VECTORS
#if !defined(__clang__)
// GCC 12 warns about intended code in its own header (GCC bug 105593).
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#include <immintrin.h>

#define AVX2 __attribute__((target("avx2")))
#define AVX512 __attribute__((target("avx512bw")))
#define AVX512_VBMI __attribute__((target("avx512vbmi,avx512bw")))
#endif
