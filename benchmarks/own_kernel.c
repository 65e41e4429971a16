/* Two hot loops in C, called by XLA: see own_kernel.py. T is float or double.

   Handlers are written to the C interface alone, since its version is all that a caller compares: a handler
   compiled with headers newer than the jaxlib that loads it is refused. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "xla/ffi/api/c_api.h"

#define WINDOWS 64 /* of a block: its rows stay in the first cache */

static int is_question(XLA_FFI_CallFrame *frame) {
  XLA_FFI_Extension_Base *asked = frame->extension_start;
  if (!asked || asked->type != XLA_FFI_Extension_Metadata) return 0;
  XLA_FFI_Metadata *metadata = ((XLA_FFI_Metadata_Extension *)asked)->metadata;
  metadata->api_version.major_version = XLA_FFI_API_MAJOR;
  metadata->api_version.minor_version = XLA_FFI_API_MINOR;
  return 1;
}

static XLA_FFI_Buffer *argument(XLA_FFI_CallFrame *frame, int i) { return frame->args.args[i]; }
static XLA_FFI_Buffer *result(XLA_FFI_CallFrame *frame, int i) { return frame->rets.rets[i]; }

/* The strip test of section 5 of Adrot 2000: windows of 2 samples, 4 circuits of 3 rows each.
   u (N + 1,), y (N + 1, 2), numbers: H (4, 4), k (4), sizes of bounds (4), c (2), rho (2), offsets (3),
   ulps, gamma, floor -> status (N,) int8, margin (N,). */
#define SIZE(x) ((x) < 0 ? -(x) : (x))
#define LARGER(x, than) ((x) > (than) ? (x) : (than)) /* NaN loses */
#define ROW(i)                                                                       \
  T value##i = y[2 * n + i], size##i = SIZE(value##i), d##i = value##i - offset[i % 2]; \
  T far##i = SIZE(d##i);
#define BOX(i, rho)                                                      \
  T over##i = LARGER(far##i - rho, 0);                                   \
  T mid##i = d##i - c[i % 2] * (d##i < 0 ? -over##i : over##i);          \
  T rad##i = rho + c[i % 2] * over##i;
#define STRIP(s, i, j, l)                                                                                     \
  {                                                                                                           \
    const T *h = H + 4 * s, *w = weight + 4 * s;                                                              \
    T far = h[i] * mid##i + h[j] * mid##j + h[l] * mid##l - k[s] * v;                                         \
    T width = w[i] * rad##i + w[j] * rad##j + w[l] * rad##l;                                                  \
    T scale = still[s] + w[i] * size##i + w[j] * size##j + w[l] * size##l + known * kept[s];                  \
    T error = gamma * (scale + width) + least;                                                                \
    far = SIZE(far);                                                                                          \
    T excess = far - width, ratio = far / width;                                                              \
    ratio = SIZE(excess) <= error ? 1 : ratio;                                                                \
    gauge = LARGER(ratio, gauge);                                                                             \
    largest = LARGER(error, largest);                                                                         \
  }

static void strips_of(int64_t N, const T *restrict u, const T *restrict y, const T *restrict numbers,
                      int8_t *restrict status, T *restrict margin) {
  T H[16], weight[16], k[4], kept[4], still[4], c[2], offset[3];
  for (int i = 0; i < 16; i++) weight[i] = SIZE(numbers[i]), H[i] = numbers[i];
  for (int i = 0; i < 4; i++) k[i] = numbers[16 + i], kept[i] = SIZE(k[i]), still[i] = numbers[20 + i];
  for (int i = 0; i < 2; i++) c[i] = numbers[24 + i];
  for (int i = 0; i < 3; i++) offset[i] = numbers[28 + i];
  const T first = numbers[26], second = numbers[27];
  const T ulps = numbers[31], gamma = numbers[32], least = numbers[33];
#pragma omp simd
  for (int64_t n = 0; n < N; n++) {
    ROW(0) ROW(1) ROW(2) ROW(3)
    T low = LARGER(size0, 0), high = LARGER(size1, 0);
    low = first + ulps * LARGER(size2, low);
    high = second + ulps * LARGER(size3, high);
    BOX(0, low) BOX(1, high) BOX(2, low) BOX(3, high)
    T v = u[n] - offset[2], known = SIZE(u[n]), gauge = -1, largest = 0;
    STRIP(0, 0, 1, 2) STRIP(1, 0, 1, 3) STRIP(2, 0, 2, 3) STRIP(3, 1, 2, 3)
    T found = 1 - gauge;
    found = (gauge < 1) & (largest > (T)1e30) ? 0 : found;
    found = largest > 0 ? found : (T)NAN;
    margin[n] = found;
    status[n] = found < 0 ? 3 : found > 0 ? 1 : found == 0 ? 2 : 0;
  }
}

XLA_FFI_Error *strips(XLA_FFI_CallFrame *frame) {
  if (is_question(frame)) return NULL;
  strips_of(argument(frame, 0)->dims[0] - 1, argument(frame, 0)->data, argument(frame, 1)->data,
            argument(frame, 2)->data, result(frame, 0)->data, result(frame, 1)->data);
  return NULL;
}

/* The fixed projection of long windows: d = P z, max |z - R d| - r.
   z (rows, N), P (STATES, rows), R (rows, STATES), r (rows) -> excess (N,). */
XLA_FFI_Error *projection(XLA_FFI_CallFrame *frame) {
  if (is_question(frame)) return NULL;
  const T *z = argument(frame, 0)->data, *P = argument(frame, 1)->data, *R = argument(frame, 2)->data;
  const T *r = argument(frame, 3)->data;
  T *excess = result(frame, 0)->data;
  int64_t rows = argument(frame, 0)->dims[0], N = argument(frame, 0)->dims[1];
  for (int64_t first = 0; first + WINDOWS <= N; first += WINDOWS) {
    T d[STATES][WINDOWS] = {{0}}, worst[WINDOWS];
    for (int n = 0; n < WINDOWS; n++) worst[n] = -INFINITY;
    for (int64_t i = 0; i < rows; i++)
      for (int s = 0; s < STATES; s++)
        for (int n = 0; n < WINDOWS; n++) d[s][n] += P[s * rows + i] * z[i * N + first + n];
    for (int64_t i = 0; i < rows; i++)
      for (int n = 0; n < WINDOWS; n++) {
        T rest = z[i * N + first + n];
        for (int s = 0; s < STATES; s++) rest -= R[i * STATES + s] * d[s][n];
        rest = (rest < 0 ? -rest : rest) - r[i];
        worst[n] = rest > worst[n] ? rest : worst[n];
      }
    for (int n = 0; n < WINDOWS; n++) excess[first + n] = worst[n];
  }
  return NULL;
}
