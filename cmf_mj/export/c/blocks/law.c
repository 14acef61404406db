#include "cmf_law.h"

#if MATHS
#include <math.h>

#endif
/* The arithmetic that gives the same bits everywhere: each operation rounded by itself. */
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ != 0)
#error "evaluate in the declared precision, such as with -msse2 -mfpmath=sse"
#endif
#if !defined(__GNUC__) || defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#define LEGS @legs@
#define FRAME (1.0 / (cmf_real)CMF_LAW_RATE) /* T [s] */

/* Inputs u of the compensator, in the order of its gains. */
#define REFERENCE 0
#define CAP_PRESSURE 1
#define ROD_PRESSURE 2
#define POSITION 3
#define VELOCITY 4
#define POSITION_ERROR_RATE 5
#define VELOCITY_ERROR 6
#define ERROR_INTEGRAL 7
#define ACCELERATION 8
#define FORCE 9
#define SIGNALS 10

typedef struct {
  cmf_real of[SIGNALS][LEGS];
} signals;

static cmf_real within(cmf_real value, cmf_real low, cmf_real high) {
  const cmf_real above = (low > value) ? low : value;
  return (high < above) ? high : above;
}
