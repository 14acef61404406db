#include "cmf.h"

#include <math.h>
#include <mujoco/mujoco.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cmf_machine.h"

#define NEVER INT64_MAX
#define STATE mjSTATE_INTEGRATION

extern const unsigned char cmf_slots_data[], cmf_arena_data[], cmf_model_data[], cmf_start_data[];
int cmf_loop(void **, void **, int64_t, int64_t, int64_t);
int cmf_demand(void **, void **, int64_t, int64_t, int64_t);

/* What a state has besides the mechanics and the arrays of the loop. */
typedef struct {
  uint64_t digest;  /* of all that follows */
  uint64_t machine; /* whose state it is */
  int64_t frame, host, arrived;
  int64_t changed; /* whether parameters wait for cmf_start */
  int64_t ended;   /* whether it has left its bounds */
  double parameter[CMF_PARAMETERS];
} head_t;

#define OF_MECHANICS sizeof(head_t)
#define OF_SENSORS (OF_MECHANICS + 8 * (size_t)CMF_MECHANICS)
#define OF_WARNINGS (OF_SENSORS + 8 * (size_t)CMF_SENSORS)
#define OF_ARENA (OF_WARNINGS + 8 * (size_t)mjNWARNING)
#define SIZE (OF_ARENA + CMF_ARENA)

struct cmf_machine {
  head_t head;
  double pose[6];
  mjModel *model, *quiet;
  mjData *data;
  int64_t slots[CMF_SLOTS];
  unsigned char *arena;
  double *mechanics; /* workspace */
  char message[200];
};

static int refused(cmf_machine *m, const char *text) {
  snprintf(m->message, sizeof m->message, "%s", text);
  return CMF_REFUSED;
}

static double *numbers(const cmf_machine *m, int slot) {
  return (double *)(intptr_t)m->slots[slot];
}
static int64_t *integers(const cmf_machine *m, int slot) {
  return (int64_t *)(intptr_t)m->slots[slot];
}

static void put(cmf_machine *m, int slot, double value) { memcpy(m->slots + slot, &value, 8); }

static uint64_t digest(const unsigned char *bytes, size_t size) {
  uint64_t sum = 14695981039346656037u; /* FNV-1a by words */
  for (size_t i = 0; i + 8 <= size; i += 8) {
    uint64_t word;
    memcpy(&word, bytes + i, 8);
    sum = (sum ^ word) * 1099511628211u;
    sum ^= sum >> 29;
  }
  return sum;
}

static void look(cmf_machine *m) { /* the platform's pose, of the row of the loop */
#if CMF_PLATFORM >= 0
  const double *q = numbers(m, AT_recorder_out) + CMF_PLATFORM;
  double w = q[3], x = q[4], y = -q[5], z = -q[6], n = 1.0 / (w * w + x * x + y * y + z * z);
  m->pose[0] = q[0], m->pose[1] = -q[1], m->pose[2] = -q[2];
  m->pose[3] = atan2(2.0 * n * (w * x + y * z), 1.0 - 2.0 * n * (x * x + y * y));
  m->pose[4] = asin(fmax(-1.0, fmin(1.0, 2.0 * n * (w * y - x * z))));
  m->pose[5] = atan2(2.0 * n * (w * z + x * y), 1.0 - 2.0 * n * (y * y + z * z));
#else
  (void)m;
#endif
}

/* Parameters. */

static void scale(cmf_machine *m, int slot, int rows, int column, double factor) {
  double *gains = numbers(m, slot);
  const double *shipped = (const double *)(cmf_arena_data + ((unsigned char *)gains - m->arena));
  for (int i = column; i < rows * CMF_SIGNALS; i += CMF_SIGNALS) gains[i] = shipped[i] * factor;
}

static void apply(cmf_machine *m) { /* all parameters to the loop and the model */
  const double *p = m->head.parameter;
  m->slots[AT_controller_guarded] = p[CMF_P_PROTECTION] != 0.0;
  for (int i = 0; i < CMF_SIGNALS; i++) {
    scale(m, AT_controller_dcl_compensator_direct_gain, CMF_LEGS, i, p[CMF_P_GAIN + i]);
    scale(m, AT_controller_dcl_compensator_input_gain, CMF_LEGS, i, p[CMF_P_GAIN + i]);
  }
  put(m, AT_dynamics_hydraulics_supply_pressure, p[CMF_P_SUPPLY_PRESSURE]);
#if CMF_BODY >= 0
  double *mass = m->model->body_mass + CMF_BODY, *centre = m->model->body_ipos + 3 * CMF_BODY;
  if (mass[0] != p[CMF_P_PAYLOAD_MASS] || memcmp(centre, p + CMF_P_PAYLOAD_MASS + 1, 24)) {
    const double factor = p[CMF_P_PAYLOAD_MASS] / cmf_starts[CMF_P_PAYLOAD_MASS];
    for (int i = 0; i < 3; i++) m->model->body_inertia[3 * CMF_BODY + i] = cmf_inertia[i] * factor;
    mass[0] = p[CMF_P_PAYLOAD_MASS];
    memcpy(centre, p + CMF_P_PAYLOAD_MASS + 1, 24);
    mj_setConst(m->model, m->data);
    double sum = 0.0;
    for (int i = 1; i < m->model->nbody; i++) sum += m->model->body_mass[i];
    m->model->stat.meanmass = sum / (double)(m->model->nbody - 1);
    sum = 0.0;
    for (int i = 0; i < m->model->nv; i++) sum += m->model->dof_M0[i];
    m->model->stat.meaninertia = sum / (double)m->model->nv;
    mj_copyModel(m->quiet, m->model);
    m->quiet->opt.disableflags |= mjDSBL_SENSOR;
  }
#endif
}

static int64_t loop(cmf_machine *m, int64_t first, int64_t last) {
  void *result, *fault;
  cmf_loop(&result, &fault, (int64_t)(intptr_t)m->slots, first, last);
  return integers(m, AT_outcome)[0];
}

static int ended(cmf_machine *m, int64_t frame) {
  static const char *const why[] = {"is not finite",
                                    "has a chamber below vacuum",
                                    "has a chamber beyond its proof pressure",
                                    "is beyond its stops",
                                    "has no solution for this step",
                                    "MuJoCo warns"};
  const int64_t *outcome = integers(m, AT_outcome);
  m->head.frame = frame;
  m->head.ended = 1;
  snprintf(m->message, sizeof m->message, "leg %d: %s at %.4f s", (int)outcome[2] + 1,
           why[outcome[1] < 0 || outcome[1] > 5 ? 5 : outcome[1]], (double)frame / CMF_RATE);
  look(m);
  return CMF_ENDED;
}

int cmf_start(cmf_machine *m) {
  if (!m->head.changed) return CMF_OK;
  m->head.changed = 0;
  apply(m);
#if CMF_ACCUMULATORS
  double gas, volume, exponent, pressure = m->head.parameter[CMF_P_SUPPLY_PRESSURE];
  memcpy(&gas, m->slots + AT_dynamics_hydraulics_supply_precharge, 8);
  memcpy(&volume, m->slots + AT_dynamics_hydraulics_supply_gas_volume, 8);
  memcpy(&exponent, m->slots + AT_dynamics_hydraulics_supply_exponent, 8);
  double ratio = (gas + CMF_ATMOSPHERE) / (pressure + CMF_ATMOSPHERE);
  double *supply = numbers(m, AT_dynamics_state_supply);
  supply[CMF_SUPPLY_OIL] = volume * (1.0 - pow(ratio, 1.0 / exponent));
  supply[CMF_SUPPLY_GAS] = pressure;
#endif
  int64_t guarded = m->slots[AT_controller_guarded], *progress = integers(m, AT_memory_progress);
  m->slots[AT_controller_guarded] = 0;
#if CMF_CHAIN
  m->slots[AT_controller_source_hosted] = 0;
#endif
  progress[0] = CMF_EVENTS; /* no failures meanwhile */
  int64_t stopped = loop(m, 0, llround(m->head.parameter[CMF_P_SETTLE] * CMF_RATE));
  progress[0] = 0;
  m->slots[AT_controller_guarded] = guarded;
#if CMF_CHAIN
  m->slots[AT_controller_source_hosted] = m->head.host;
#endif
  memset(numbers(m, AT_dynamics_state_energy), 0, 8 * CMF_ENERGIES);
  memset(numbers(m, AT_recorder_out) + CMF_ENERGY_COLUMN, 0, 8 * CMF_ENERGIES);
  numbers(m, AT_memory_gimbal_error)[0] = 0.0;
  m->data->time = 0.0;
  look(m);
  return stopped < 0 ? CMF_OK : ended(m, 0);
}

/* States. */

size_t cmf_state_size(void) { return SIZE; }

void cmf_get_state(const cmf_machine *m, void *state) {
  unsigned char *bytes = state;
  head_t head = m->head;
  mj_getState(m->model, m->data, m->mechanics, STATE);
  memcpy(bytes + OF_MECHANICS, m->mechanics, 8 * CMF_MECHANICS);
  memcpy(bytes + OF_SENSORS, m->data->sensordata, 8 * CMF_SENSORS);
  memcpy(bytes + OF_WARNINGS, m->data->warning, 8 * mjNWARNING);
  memcpy(bytes + OF_ARENA, m->arena, CMF_ARENA);
  memcpy(bytes, &head, sizeof head);
  head.digest = digest(bytes + 8, SIZE - 8);
  memcpy(bytes, &head, sizeof head);
}

static void restore(cmf_machine *m, const unsigned char *bytes, int whole) {
  memcpy(m->arena, bytes + OF_ARENA, CMF_ARENA);
  if (whole) memcpy(&m->head, bytes, sizeof(head_t));
  apply(m);
#if CMF_CHAIN
  m->slots[AT_controller_source_hosted] = m->head.host;
#endif
  memcpy(m->mechanics, bytes + OF_MECHANICS, 8 * CMF_MECHANICS);
  mj_setState(m->model, m->data, m->mechanics, STATE);
  mj_step1(m->model, m->data);
  mj_setState(m->model, m->data, m->mechanics, STATE);
  memcpy(m->data->sensordata, bytes + OF_SENSORS, 8 * CMF_SENSORS);
  memcpy(m->data->warning, bytes + OF_WARNINGS, 8 * mjNWARNING);
  look(m);
}

int cmf_set_state(cmf_machine *m, const void *state, size_t size) {
  head_t head;
  if (size != SIZE) return refused(m, "state: is of another size; allowed: one of this machine");
  memcpy(&head, state, sizeof head);
  if (head.machine != CMF_DIGEST) return refused(m, "state: is another machine's");
  if (head.digest != digest((const unsigned char *)state + 8, SIZE - 8))
    return refused(m, "state: is damaged");
  restore(m, state, 1);
  return CMF_OK;
}

int cmf_reset(cmf_machine *m) {
  m->head.frame = m->head.arrived = m->head.ended = 0;
  restore(m, cmf_start_data, 0);
  m->head.changed = memcmp(m->head.parameter, cmf_starts, sizeof cmf_starts) != 0;
  return CMF_OK;
}

/* Making and unmaking. */

cmf_machine *cmf_create(void) {
  if (mj_version() != CMF_MUJOCO) return NULL;
  cmf_machine *m = calloc(1, sizeof *m);
  if (!m) return NULL;
  m->arena = malloc(CMF_ARENA);
  m->mechanics = malloc(8 * CMF_MECHANICS);
  m->model = mj_loadModelBuffer(cmf_model_data, CMF_MODEL);
  m->quiet = m->model ? mj_copyModel(NULL, m->model) : NULL;
  m->data = m->model ? mj_makeData(m->model) : NULL;
  if (!m->arena || !m->mechanics || !m->quiet || !m->data) {
    cmf_free(m);
    return NULL;
  }
  m->quiet->opt.disableflags |= mjDSBL_SENSOR;
  memcpy(m->slots, cmf_slots_data, sizeof m->slots);
  for (size_t i = 0; i < sizeof cmf_pointers / sizeof *cmf_pointers; i++)
    m->slots[cmf_pointers[i]] += (int64_t)(intptr_t)m->arena;
  const mjData *d = m->data;
  const struct {
    int slot;
    const void *address;
  } views[] = {{AT_dynamics_mechanics_model, m->model},
               {AT_dynamics_mechanics_quiet, m->quiet},
               {AT_dynamics_mechanics_data, d},
               {AT_dynamics_mechanics_length, d->actuator_length},
               {AT_dynamics_mechanics_ctrl, d->ctrl},
               {AT_dynamics_mechanics_payload, d->xfrc_applied},
               {AT_dynamics_mechanics_sensordata, d->sensordata},
               {AT_dynamics_mechanics_site, d->site_xpos},
               {AT_dynamics_mechanics_qpos, d->qpos},
               {AT_dynamics_mechanics_warnings, &d->warning[0].number}};
  for (size_t i = 0; i < sizeof views / sizeof *views; i++)
    m->slots[views[i].slot] = (int64_t)(intptr_t)views[i].address;
  m->slots[AT_dynamics_mechanics_position_stage] = (int64_t)(intptr_t)mj_step1;
  m->slots[AT_dynamics_mechanics_force_stage] = (int64_t)(intptr_t)mj_step2;
  restore(m, cmf_start_data, 1);
  return m;
}

void cmf_free(cmf_machine *m) {
  if (!m) return;
  if (m->data) mj_deleteData(m->data);
  if (m->quiet) mj_deleteModel(m->quiet);
  if (m->model) mj_deleteModel(m->model);
  free(m->arena);
  free(m->mechanics);
  free(m);
}

/* Inputs. */

static int all_finite(const double *values, int count) {
  for (int i = 0; i < count; i++)
    if (!isfinite(values[i])) return 0;
  return 1;
}

int cmf_set_input(cmf_machine *m, enum cmf_input input) {
  if (input != CMF_REFERENCE && (input != CMF_HOST || !CMF_CHAIN))
    return refused(m, "input: this machine has no such kind");
  if (m->head.frame) return refused(m, "input: is chosen before the first frame");
#if CMF_CHAIN
  m->slots[AT_controller_source_hosted] = m->head.host = input == CMF_HOST;
#endif
  return CMF_OK;
}

int cmf_set_reference(cmf_machine *m, const double *legs) {
  if (m->head.host) return refused(m, "reference: comes from the host");
  if (!all_finite(legs, CMF_LEGS)) return refused(m, "reference: is not finite");
  memcpy(numbers(m, AT_controller_source_table), legs, 8 * CMF_LEGS);
  return CMF_OK;
}

int cmf_set_pose(cmf_machine *m, const double pose[6]) {
#if CMF_CHAIN
  if (m->head.host) return refused(m, "pose: comes from the host");
  if (!all_finite(pose, 6)) return refused(m, "pose: is not finite");
  void *result, *fault;
  double *motion = numbers(m, AT_controller_source_motion);
  memset(motion, 0, 18 * 8);
  memcpy(motion, pose, 6 * 8);
  memcpy(numbers(m, AT_controller_source_poses), pose, 6 * 8);
  int64_t slots[CMF_DEMAND_SLOTS + 10]; /* geometry, motion, legs */
  memcpy(slots, m->slots + AT_controller_source_blocks_geometry_upper, 8 * CMF_DEMAND_SLOTS);
  memcpy(slots + CMF_DEMAND_SLOTS, m->slots + AT_controller_source_motion, 5 * 8);
  memcpy(slots + CMF_DEMAND_SLOTS + 5, m->slots + AT_controller_source_legs, 5 * 8);
  cmf_demand(&result, &fault, (int64_t)(intptr_t)slots, 0, 0);
  memcpy(numbers(m, AT_controller_source_table), numbers(m, AT_controller_source_legs), 6 * 8);
  return CMF_OK;
#else
  (void)pose;
  return refused(m, "pose: this machine takes references of its actuators");
#endif
}

int cmf_host_frame(cmf_machine *m, int64_t sequence, double time, const double motion[18]) {
#if CMF_CHAIN
  if (!m->head.host) return refused(m, "host: the reference does not come from the host");
  int64_t *frame = integers(m, AT_controller_source_arrivals_frame),
          *progress = integers(m, AT_controller_source_progress);
  if (progress[0] == m->head.arrived) { /* all before have had their turn */
    for (int64_t i = 0; i < m->head.arrived; i++) frame[i] = NEVER;
    progress[0] = m->head.arrived = 0;
  }
  int64_t place = m->head.arrived;
  if (place == CMF_ARRIVALS) return refused(m, "host: too many frames since the last cmf_step");
  frame[place] = m->head.frame;
  integers(m, AT_controller_source_arrivals_sequence)[place] = sequence;
  numbers(m, AT_controller_source_arrivals_time)[place] = time;
  memcpy(numbers(m, AT_controller_source_arrivals_values) + 18 * place, motion, 18 * 8);
  m->head.arrived++;
  return CMF_OK;
#else
  (void)sequence, (void)time, (void)motion;
  return refused(m, "host: this machine has none");
#endif
}

int cmf_request_state(cmf_machine *m, enum cmf_request request) {
#if CMF_CHAIN
  if (!m->head.host) return refused(m, "request: the reference does not come from the host");
  if ((int)request < 0 || request > CMF_REQUEST_RESET)
    return refused(m, "request: there is none such");
  integers(m, AT_controller_source_request_frame)[0] = m->head.frame;
  integers(m, AT_controller_source_request)[0] = request;
  return CMF_OK;
#else
  (void)request;
  return refused(m, "request: this machine has no operating states");
#endif
}

int cmf_inject(cmf_machine *m, int failure, double at, int leg, int valve, double size) {
  const cmf_failure_info *info = cmf_failure_at(failure);
  if (!info) return refused(m, "failure: there is none such");
  if (!(at >= 0.0 && at <= CMF_LONGEST)) return refused(m, "at: is not a time of a run");
  int64_t when = llround(at * CMF_RATE), *frames = integers(m, AT_dynamics_timeline_frame);
  if (when < m->head.frame) return refused(m, "at: is past");
  if (info->leg ? leg < 1 || leg > CMF_LEGS : leg != 0)
    return refused(m, "leg: allowed: one of the machine, or 0 where the failure has none");
  if (valve < 0 || valve > (info->valve ? 2 : 0))
    return refused(m, "valve: allowed: 1, 2, or 0 for both and where the failure has none");
  if (!isfinite(size)) return refused(m, "size: is not finite");
  int count = 0, place;
  while (count < CMF_EVENTS && frames[count] != NEVER) count++;
  if (count == CMF_EVENTS) return refused(m, "failure: there are too many");
  const int columns[] = {AT_dynamics_timeline_frame, AT_dynamics_timeline_kind,
                         AT_dynamics_timeline_leg, AT_dynamics_timeline_valve,
                         AT_dynamics_timeline_size};
  for (place = count; place > 0 && frames[place - 1] > when; place--)
    for (int i = 0; i < 5; i++) integers(m, columns[i])[place] = integers(m, columns[i])[place - 1];
  const int64_t row[] = {when, failure, leg - 1, valve - 1};
  for (int i = 0; i < 4; i++) integers(m, columns[i])[place] = row[i];
  numbers(m, AT_dynamics_timeline_size)[place] = size;
  return CMF_OK;
}

int cmf_step(cmf_machine *m, int64_t frames) {
  int64_t stopped;
  if (m->head.ended) return refused(m, "the run has ended; reset, or set a state");
  if (frames < 0 || frames > CMF_MOST) return refused(m, "frames: is not a number of frames");
  if (cmf_start(m)) return CMF_ENDED;
  if (!frames) return CMF_OK;
  stopped = loop(m, m->head.frame, m->head.frame + frames);
  if (stopped >= 0) return ended(m, stopped);
  m->head.frame += frames;
  look(m);
  return CMF_OK;
}

int64_t cmf_frame(const cmf_machine *m) { return m->head.frame; }
const char *cmf_message(const cmf_machine *m) { return m->message; }

/* Tables. */

int cmf_legs(void) { return CMF_LEGS; }
int cmf_channels(void) { return sizeof cmf_channel_table / sizeof *cmf_channel_table; }
int cmf_parameters(void) { return CMF_PARAMETERS; }
int cmf_failures(void) { return sizeof cmf_failure_table / sizeof *cmf_failure_table; }

const cmf_channel_info *cmf_channel_at(int i) {
  return i < 0 || i >= cmf_channels() ? NULL : cmf_channel_table + i;
}

const cmf_channel_info *cmf_find_channel(const char *name) {
  for (int i = 0; i < cmf_channels(); i++)
    if (!strcmp(cmf_channel_table[i].name, name)) return cmf_channel_table + i;
  return NULL;
}

const double *cmf_channel(const cmf_machine *m, const cmf_channel_info *channel) {
  return channel->first < 0 ? m->pose : numbers(m, AT_recorder_out) + channel->first;
}

const cmf_parameter_info *cmf_parameter_at(int i) {
  return i < 0 || i >= CMF_PARAMETERS ? NULL : cmf_parameter_table + i;
}

const cmf_failure_info *cmf_failure_at(int i) {
  return i < 0 || i >= cmf_failures() ? NULL : cmf_failure_table + i;
}

double cmf_parameter(const cmf_machine *m, int i) {
  return cmf_parameter_at(i) ? m->head.parameter[i] : NAN;
}

int cmf_set_parameter(cmf_machine *m, int i, double value) {
  const cmf_parameter_info *info = cmf_parameter_at(i);
  if (!info) return refused(m, "parameter: there is none such");
  if (m->head.frame) return refused(m, "parameter: changes before the first frame");
  if (!(value >= info->least && value <= info->most)) {
    snprintf(m->message, sizeof m->message, "%s: %g %s; allowed: %g to %g", info->name, value,
             info->unit, info->least, info->most);
    return CMF_REFUSED;
  }
  if (m->head.parameter[i] == value) return CMF_OK;
  if (m->head.ended) return refused(m, "the run has ended; reset, or set a state");
  m->head.parameter[i] = value;
  m->head.changed = 1;
  return CMF_OK;
}
