/* What FMI 2 and 3 have in common; their sources define FMI() and the names that differ.
 *
 * Value references: inputs, parameters of the machine, `host`, failures, outputs, in this order.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cmf.h"
#include "cmf_fmu.h"

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { CREATED = 1, INITIALISING = 2, STEPPING = 4, ENDED = 8, FAILED = 16, ANY = 31 };
enum { REAL, INTEGER, BOOLEAN };

#define FIRST_PARAMETER FMU_INPUTS
#define HOST (FIRST_PARAMETER + FMU_PARAMETERS)
#define FIRST_FAILURE (HOST + 1)
#define FIRST_OUTPUT (FIRST_FAILURE + 5 * FMU_FAILURES)
#define VARIABLES (FIRST_OUTPUT + FMU_OUTPUTS)
#define TIME VARIABLES /* of FMI 3 */
#define RATE 80.0      /* frames a second of the host that the inputs stand for */

typedef struct {
  uint64_t digest; /* of what follows, in a saved state */
  double start, time;
  int64_t phase, dirty;  /* dirty: the machine is not at rest with its parameters */
  int64_t sequence, due; /* of the host's next frame: its number, and when, in 1/RATE s */
  double value[FIRST_OUTPUT];
} now_t;

typedef struct {
  now_t now;
  cmf_machine *machine;
  void (*logger)(void); /* as each version has it */
  void *environment;
  int logging;
  char name[64];
} fmu_t;

typedef fmu_t *Component;
typedef unsigned Reference;
typedef int Status;
typedef const char *String;
#ifndef SWITCH
#define SWITCH int
#endif
#define SETTABLE (CREATED | INITIALISING | STEPPING)

static void tell(const fmu_t *f, int status, const char *text);

static int fail(const fmu_t *f, int status, const char *text) {
  if (f->logger) tell(f, status, text);
  return status;
}

static int allowed(fmu_t *f, int phases, const char *function) {
  char text[120];
  if (!f) return 0;
  if (f->now.phase & phases) return 1;
  snprintf(text, sizeof text, "%s is not allowed now", function);
  fail(f, ERROR, text);
  return 0;
}

static int type(unsigned v) {
  if (v == HOST) return BOOLEAN;
  if (v < FIRST_FAILURE || v >= FIRST_OUTPUT) return REAL;
  return (v - FIRST_FAILURE) % 5 - 1 < 3 ? INTEGER : REAL; /* at, kind, leg, valve, size */
}

static int restart(fmu_t *f) { /* at rest with its parameters */
  if (!f->now.dirty) return OK;
  cmf_reset(f->machine);
  if (cmf_start(f->machine)) return fail(f, ERROR, cmf_message(f->machine));
  f->now.dirty = 0;
  return OK;
}

static void blank(fmu_t *f) {
  memset(&f->now, 0, sizeof f->now);
  f->now.phase = CREATED;
  f->now.dirty = 1;
  cmf_reset(f->machine);
  for (int i = 0; i < FMU_PARAMETERS; i++) {
    f->now.value[FIRST_PARAMETER + i] = cmf_parameter_at(i)->start;
    cmf_set_parameter(f->machine, i, cmf_parameter_at(i)->start);
  }
  memcpy(f->now.value, fmu_starts, sizeof fmu_starts);
}

static fmu_t *create(const char *name, const char *token, const void *logger, void *environment,
                     int logging) {
  fmu_t *f = calloc(1, sizeof *f);
  if (!f) return NULL;
  memcpy(&f->logger, logger, sizeof f->logger);
  f->environment = environment, f->logging = logging;
  snprintf(f->name, sizeof f->name, "%s", name ? name : "");
  if (!token || strcmp(token, FMU_TOKEN))
    fail(f, ERROR, "the token or the kind of simulation is not that of this FMU");
  else if (!(f->machine = cmf_create()))
    fail(f, ERROR, "no memory, or another version of MuJoCo");
  if (f->machine) return blank(f), f;
  free(f);
  return NULL;
}

static int times(fmu_t *f, double start, int ends, double stop) {
  if (!isfinite(start) || (ends && !(stop >= start))) return fail(f, ERROR, "times: are refused");
  f->now.start = f->now.time = start;
  return OK;
}

static int get(fmu_t *f, unsigned v, int kind, double *value) {
  if (v == TIME && kind == REAL) return *value = f->now.time, OK;
  if (v >= VARIABLES || type(v) != kind) return fail(f, ERROR, "there is no such variable");
  if (v < FIRST_OUTPUT) return *value = f->now.value[v], OK;
  if (f->now.phase == INITIALISING && restart(f)) return ERROR;
  const short *at = fmu_outputs[v - FIRST_OUTPUT];
  *value = cmf_channel(f->machine, cmf_channel_at(at[0]))[at[1]];
  return OK;
}

static int set(fmu_t *f, unsigned v, int kind, double value) {
  char text[120];
  if (v >= FIRST_OUTPUT || type(v) != kind)
    return fail(f, ERROR, "there is no such variable to set");
  if (!isfinite(value)) {
    snprintf(text, sizeof text, "variable %u: must be finite", v);
    return fail(f, ERROR, text);
  }
  if (v >= FIRST_PARAMETER) {
    if (!(f->now.phase & (CREATED | INITIALISING)))
      return fail(f, ERROR, "a parameter is fixed after initialisation");
    if (v < HOST) {
      if (cmf_set_parameter(f->machine, (int)(v - FIRST_PARAMETER), value))
        return fail(f, ERROR, cmf_message(f->machine));
      f->now.dirty = 1;
    }
  }
  f->now.value[v] = value;
  return OK;
}

static int inputs(fmu_t *f) { /* hand the inputs to the machine */
  const double *x = f->now.value;
  int refused = 0;
#if FMU_CHAIN
  if (x[HOST] != 0.0) {
    double t = f->now.time - f->now.start;
    if (t + 1e-9 < (double)f->now.due / RATE) return OK;
    f->now.due = (int64_t)floor((t + 1e-9) * RATE) + 1;
    refused = cmf_host_frame(f->machine, f->now.sequence++, t, x);
  } else
    refused = cmf_set_pose(f->machine, x);
#else
  refused = cmf_set_reference(f->machine, x);
#endif
  return refused ? fail(f, ERROR, cmf_message(f->machine)) : OK;
}

static double size(const double *failure) { /* as given, or as its kind has it */
  const cmf_failure_info *info = cmf_failure_at((int)failure[1] - 1);
  return failure[4] == 0.0 && info ? info->size : failure[4];
}

static int initialise(fmu_t *f) {
  cmf_machine *m = f->machine;
  const double *e = f->now.value + FIRST_FAILURE;
  if (restart(f)) return ERROR;
  f->now.time = f->now.start;
  if (FMU_CHAIN && cmf_set_input(m, f->now.value[HOST] != 0.0 ? CMF_HOST : CMF_REFERENCE))
    return fail(f, ERROR, cmf_message(m));
  for (int i = 0; i < FMU_FAILURES; i++, e += 5)
    if (e[1] != 0.0 && cmf_inject(m, (int)e[1] - 1, e[0], (int)e[2], (int)e[3], size(e)))
      return fail(f, ERROR, cmf_message(m));
  f->now.phase = STEPPING;
  return OK;
}

static int advance(fmu_t *f, double time, double size) {
  double near = 1e-9 * fmax(1.0, fabs(time));
  if (!isfinite(time) || !isfinite(size)) return fail(f, ERROR, "step: is not finite");
  if (fabs(time - f->now.time) > near)
    return fail(f, ERROR, "step: does not begin where the last ended");
  if (!(size >= 0.0)) return fail(f, ERROR, "step: goes backwards");
  double frames = (time + size - f->now.start) * CMF_RATE;
  if (!(frames < 4e15)) return fail(f, ERROR, "step: is too long");
  if (inputs(f)) return ERROR;
  int64_t count = llround(frames) - cmf_frame(f->machine);
  if (f->logging) fail(f, OK, "step");
  if (cmf_step(f->machine, count > 0 ? count : 0)) {
    f->now.phase = FAILED;
    return fail(f, ERROR, cmf_message(f->machine));
  }
  f->now.time = time + size;
  return OK;
}

/* States: what is here, then the machine's. */

#define SIZE (sizeof(now_t) + cmf_state_size())

static uint64_t digest(const now_t *now) {
  uint64_t sum = 14695981039346656037u, words[sizeof *now / 8];
  memcpy(words, now, sizeof words);
  for (size_t i = 1; i < sizeof words / 8; i++) {
    sum = (sum ^ words[i]) * 1099511628211u;
    sum ^= sum >> 29;
  }
  return sum;
}

static void save(const fmu_t *f, unsigned char *bytes) {
  now_t now = f->now;
  now.digest = digest(&now);
  memcpy(bytes, &now, sizeof now);
  cmf_get_state(f->machine, bytes + sizeof now);
}

static int load(fmu_t *f, const unsigned char *bytes) {
  now_t now;
  memcpy(&now, bytes, sizeof now);
  if (now.digest != digest(&now)) return fail(f, ERROR, "state: is damaged");
  if (cmf_set_state(f->machine, bytes + sizeof now, cmf_state_size()))
    return fail(f, ERROR, cmf_message(f->machine));
  f->now = now;
  return OK;
}

#ifdef __GNUC__
#pragma GCC visibility push(default)
#endif

void FMI(FreeInstance)(Component f) {
  if (f) cmf_free(f->machine);
  free(f);
}

Status FMI(SetDebugLogging)(Component f, SWITCH on, size_t count, const String categories[]) {
  (void)count, (void)categories;
  if (!allowed(f, ANY, __func__)) return ERROR;
  f->logging = on;
  return OK;
}

Status FMI(ExitInitializationMode)(Component f) {
  return allowed(f, INITIALISING, __func__) ? initialise(f) : ERROR;
}

Status FMI(Terminate)(Component f) {
  if (!allowed(f, STEPPING, __func__)) return ERROR;
  f->now.phase = ENDED;
  return OK;
}

Status FMI(Reset)(Component f) {
  if (!allowed(f, ANY, __func__)) return ERROR;
  blank(f);
  return OK;
}

Status GET_STATE(Component f, unsigned char **state) {
  if (!allowed(f, ANY, __func__) || !state) return ERROR;
  if (!*state && !(*state = malloc(SIZE))) return fail(f, ERROR, "no memory");
  save(f, *state);
  return OK;
}

Status SET_STATE(Component f, const unsigned char *state) {
  return allowed(f, ANY, __func__) && state ? load(f, state) : ERROR;
}

Status FREE_STATE(Component f, unsigned char **state) {
  (void)f;
  if (!state) return ERROR;
  free(*state);
  *state = NULL;
  return OK;
}

Status STATE_SIZE(Component f, const unsigned char *state, size_t *size) {
  (void)state;
  if (!allowed(f, ANY, __func__) || !size) return ERROR;
  *size = SIZE;
  return OK;
}

Status SERIALIZE(Component f, const unsigned char *state, unsigned char bytes[], size_t size) {
  if (!allowed(f, ANY, __func__) || !state || !bytes) return ERROR;
  if (size < SIZE) return fail(f, ERROR, "state: needs more room");
  memcpy(bytes, state, SIZE);
  return OK;
}

Status DESERIALIZE(Component f, const unsigned char bytes[], size_t size, unsigned char **state) {
  if (!allowed(f, ANY, __func__) || !state || !bytes) return ERROR;
  if (size != SIZE) return fail(f, ERROR, "state: is of another size");
  if (!*state && !(*state = malloc(SIZE))) return fail(f, ERROR, "no memory");
  memcpy(*state, bytes, SIZE);
  return OK;
}

/* A function that is not provided; on x86-64 it may be called with its other arguments. */
#define NONE(name)          \
  Status name(Component f); \
  Status name(Component f) { return f ? fail(f, ERROR, #name " is not provided") : ERROR; }
