/* One control law of a motion base: the DCL from leg reference to valve command, a frame at a time.
 *
 * A cmf_law is plain memory of the caller's, any number of them. Nothing is allocated, nothing is
 * shared, and nothing but the C mathematics library is called. Arrays have one entry a leg.
 */
#ifndef CMF_LAW_H
#define CMF_LAW_H

#include <stdint.h>

#include "cmf_law_data.h" /* which law: CMF_LAW_NAME, CMF_LAW_LEGS, its gains */

#ifdef __cplusplus
extern "C" {
#endif
#ifdef __GNUC__
#pragma GCC visibility push(default)
#endif

typedef struct {
  double reference[CMF_LAW_LEGS];    /* leg demand: extension from neutral [m], positive out */
  double position[CMF_LAW_LEGS];     /* leg extension [m] */
  double velocity[CMF_LAW_LEGS];     /* leg velocity [m/s] */
  double acceleration[CMF_LAW_LEGS]; /* leg acceleration [m/s^2] */
  double cap_pressure[CMF_LAW_LEGS]; /* [Pa] gauge */
  double rod_pressure[CMF_LAW_LEGS]; /* [Pa] gauge */
} cmf_law_input;

typedef struct {
  double output[CMF_LAW_LEGS];  /* of the compensator, fraction of full command */
  double command[CMF_LAW_LEGS]; /* the same within -1 and 1, to the valves; positive extends */
} cmf_law_output;

typedef struct {
  double memory[CMF_LAW_WORDS];
  int64_t slots[CMF_LAW_SLOTS];
} cmf_law;

void cmf_law_start(cmf_law *); /* engaged at neutral, at rest, with equal pressures */
void cmf_law_step(cmf_law *, const cmf_law_input *, cmf_law_output *); /* one frame */

/* States, one entry a leg or hydraulic mode, by the names that records give them. */
int cmf_law_states(void);
const char *cmf_law_state_name(int index);
double *cmf_law_state(cmf_law *, int index); /* NULL beyond the last */

#ifdef __GNUC__
#pragma GCC visibility pop
#endif
#ifdef __cplusplus
}
#endif
#endif
