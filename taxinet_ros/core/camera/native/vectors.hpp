// For what is written for one kind of processor, within `#if defined(WITH_VECTORS)`.

#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(PLAIN)
#define WITH_VECTORS
#if !defined(__clang__)
// GCC 12 warns of what its own header does on purpose (its bug 105593).
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#include <immintrin.h>

#define AVX2 __attribute__((target("avx2")))
#define AVX512 __attribute__((target("avx512bw")))
#define AVX512_VBMI __attribute__((target("avx512vbmi,avx512bw")))
#endif
