/* A motion base with its hydraulics, electronics and control law, 2048 frames a second.
 *
 * One cmf_machine is one machine; a process may have any number, each used by one thread at a time.
 * Functions that may refuse return 0 when all is well; cmf_message then says what was wrong with
 * the last that did not. All numbers are SI: m, rad, N, Pa gauge, s. A pose is surge, sway, heave,
 * roll, pitch, yaw: x forward, y right, z down. Legs count from 1.
 */
#ifndef CMF_H
#define CMF_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif
#if defined(__GNUC__) && !defined(CMF_HIDDEN)
#pragma GCC visibility push(default)
#endif

#define CMF_RATE 2048.0 /* frames a second */

typedef struct cmf_machine cmf_machine;

enum { CMF_OK, CMF_REFUSED, CMF_ENDED }; /* ended: the state left its physical bounds */

enum cmf_input {
  CMF_REFERENCE, /* cmf_set_pose, cmf_set_reference: what is set holds until it is set again */
  CMF_HOST       /* cmf_host_frame, cmf_request_state: through DCU, limits and operating states */
};

/* What the operator wants. */
enum cmf_request {
  CMF_REQUEST_NONE,
  CMF_REQUEST_OFF,
  CMF_REQUEST_SETTLE,
  CMF_REQUEST_RAISE,
  CMF_REQUEST_HOLD,
  CMF_REQUEST_ENGAGE,
  CMF_REQUEST_TRIP,
  CMF_REQUEST_RESET
};

typedef struct {
  const char *name, *unit;
  int width; /* numbers it has */
  int first; /* for cmf_channel */
} cmf_channel_info;

typedef struct {
  const char *name, *unit, *text;
  double start, least, most;
} cmf_parameter_info;

typedef struct {
  const char *name, *unit; /* of the failure, of its size */
  int leg, valve;          /* whether it has a leg, and a valve of it */
  double size;             /* by default */
} cmf_failure_info;

/* At rest at the start; NULL without memory, or with another version of MuJoCo. */
cmf_machine *cmf_create(void);
void cmf_free(cmf_machine *);
int cmf_reset(cmf_machine *); /* to where it was created; parameters keep their values */

/* Inputs. The kind is chosen before the first frame and is CMF_REFERENCE by default. */
int cmf_set_input(cmf_machine *, enum cmf_input);
int cmf_set_pose(cmf_machine *, const double pose[6]);
int cmf_set_reference(cmf_machine *, const double *legs); /* extensions, or valve commands where
                                                             there is no law; cmf_legs of them */
int cmf_host_frame(cmf_machine *, int64_t sequence, double time, const double motion[18]);
int cmf_request_state(cmf_machine *, enum cmf_request);
int cmf_inject(cmf_machine *, int failure, double at, int leg, int valve, double size);

/* Run a number of frames. No memory is allocated, no file is opened, nothing is locked. */
int cmf_step(cmf_machine *, int64_t frames);
int64_t cmf_frame(const cmf_machine *); /* frames run so far */
const char *cmf_message(const cmf_machine *);

/* Channels of the last frame, as at its beginning; before the first, those of the start. */
int cmf_legs(void);
int cmf_channels(void);
const cmf_channel_info *cmf_channel_at(int index);      /* NULL beyond the last */
const cmf_channel_info *cmf_find_channel(const char *); /* NULL where there is none */
const double *cmf_channel(const cmf_machine *, const cmf_channel_info *);

/* Parameters change before the first frame. Those of the machine let it come to rest again, for
 * as long as the parameter `settle` says, with the law engaged, before time 0. */
int cmf_parameters(void);
const cmf_parameter_info *cmf_parameter_at(int index);
int cmf_set_parameter(cmf_machine *, int index, double value);
double cmf_parameter(const cmf_machine *, int index);
int cmf_start(cmf_machine *); /* apply them now; else the first frame does */

int cmf_failures(void);
const cmf_failure_info *cmf_failure_at(int index);

/* The whole state, to go on from; parameters are part of it. */
size_t cmf_state_size(void);
void cmf_get_state(const cmf_machine *, void *state);
int cmf_set_state(cmf_machine *, const void *state, size_t size);

#if defined(__GNUC__) && !defined(CMF_HIDDEN)
#pragma GCC visibility pop
#endif
#ifdef __cplusplus
}
#endif
#endif
