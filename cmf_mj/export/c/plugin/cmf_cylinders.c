/* A plugin of MuJoCo: the cylinders of one machine, with their valves, oil and supply, as actuators.
 *
 * One instance drives all actuators that name it, in their order; ctrl is the valve command, -1 to 1.
 * A step goes as in the loop: the pressures advance from the last step's extensions to the present
 * ones, with the commands of the last step, and push. What moves is plugin_state, and nothing else:
 * states may be copied, set and rolled out.
 */
#include <math.h>
#include <mujoco/mujoco.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "cmf_cylinders.h"

extern const unsigned char cmf_slots_data[], cmf_fixed_data[], cmf_moving_data[];
int cmf_push(void **, void **, int64_t, int64_t, int64_t);

typedef struct {
  int64_t slots[CMF_SLOTS];
  double fixed[CMF_FIXED / 8], moving[CMF_MOVING / 8];
} cylinders_t;

#define BEGUN (CMF_MOVING / 8) /* the last number of a state: whether a step has been made */

static double *numbers(const cylinders_t *c, int slot) {
  return (double *)(intptr_t)c->slots[slot];
}

static void place(cylinders_t *c) {
  memcpy(c->slots, cmf_slots_data, sizeof c->slots);
  for (size_t i = 0; i < sizeof cmf_pointers / sizeof *cmf_pointers; i++)
    c->slots[cmf_pointers[i]] +=
        (int64_t)(intptr_t)(i < CMF_FIXED_POINTERS ? c->fixed : c->moving);
}

static cylinders_t *of(const mjData *d, int instance) {
  return (cylinders_t *)d->plugin_data[instance];
}

static int state_size(const mjModel *m, int instance) {
  (void)m, (void)instance;
  return BEGUN + 1;
}

static int init(const mjModel *m, mjData *d, int instance) {
  int count = 0;
  for (int i = 0; i < m->nu; i++) count += m->actuator_plugin[i] == instance;
  if (count != CMF_LEGS || m->opt.timestep != CMF_STEP) {
    mju_warning("cmf.cylinders: needs %d actuators and a timestep of %g s", CMF_LEGS, CMF_STEP);
    return -1;
  }
  cylinders_t *c = malloc(sizeof *c);
  if (!c) return -1;
  memcpy(c->fixed, cmf_fixed_data, sizeof c->fixed);
  memcpy(c->moving, cmf_moving_data, sizeof c->moving);
  place(c);
  d->plugin_data[instance] = (uintptr_t)c;
  return 0;
}

static void destroy(mjData *d, int instance) {
  free(of(d, instance));
  d->plugin_data[instance] = 0;
}

static void copy(mjData *to, const mjModel *m, const mjData *from, int instance) {
  (void)m;
  memcpy(of(to, instance), of(from, instance), sizeof(cylinders_t));
  place(of(to, instance));
}

static void reset(const mjModel *m, mjtNum *state, void *data, int instance) {
  (void)m, (void)data, (void)instance;
  memcpy(state, cmf_moving_data, CMF_MOVING);
  state[BEGUN] = 0.0;
}

static void compute(const mjModel *m, mjData *d, int instance, int capability) {
  (void)capability;
  cylinders_t *c = of(d, instance);
  const mjtNum *state = d->plugin_state + m->plugin_stateadr[instance];
  void *result, *fault;
  int leg = 0;
  memcpy(c->moving, state, CMF_MOVING);
  for (int i = 0; i < m->nu; i++)
    if (m->actuator_plugin[i] == instance) {
      numbers(c, CMF_AFTER)[leg] = d->actuator_length[i] - numbers(c, CMF_NEUTRAL)[leg];
      leg++;
    }
  if (state[BEGUN] == 0.0) memcpy(numbers(c, CMF_BEFORE), numbers(c, CMF_AFTER), 8 * CMF_LEGS);
  cmf_push(&result, &fault, (int64_t)(intptr_t)c->slots, state[BEGUN] != 0.0, 0);
  leg = 0;
  for (int i = 0; i < m->nu; i++)
    if (m->actuator_plugin[i] == instance) d->actuator_force[i] = numbers(c, CMF_LOAD)[leg++];
}

static void advance(const mjModel *m, mjData *d, int instance) {
  cylinders_t *c = of(d, instance);
  mjtNum *state = d->plugin_state + m->plugin_stateadr[instance];
  int leg = 0;
  memcpy(numbers(c, CMF_BEFORE), numbers(c, CMF_AFTER), 8 * CMF_LEGS);
  for (int i = 0; i < m->nu; i++)
    if (m->actuator_plugin[i] == instance)
      numbers(c, CMF_COMMAND)[leg++] = fmax(-1.0, fmin(1.0, d->ctrl[i]));
  memcpy(state, c->moving, CMF_MOVING);
  state[BEGUN] = 1.0;
}

mjPLUGIN_LIB_INIT(cmf_cylinders) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "cmf.cylinders." CMF_NAME;
  plugin.capabilityflags = mjPLUGIN_ACTUATOR;
  plugin.nstate = state_size;
  plugin.init = init;
  plugin.destroy = destroy;
  plugin.copy = copy;
  plugin.reset = reset;
  plugin.compute = compute;
  plugin.advance = advance;
  mjp_registerPlugin(&plugin);
}
