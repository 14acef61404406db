/* FMI 2.0 for co-simulation. */
#define FMI(name) fmi2##name
#define GET_STATE fmi2GetFMUstate
#define SET_STATE fmi2SetFMUstate
#define FREE_STATE fmi2FreeFMUstate
#define STATE_SIZE fmi2SerializedFMUstateSize
#define SERIALIZE fmi2SerializeFMUstate
#define DESERIALIZE fmi2DeSerializeFMUstate
#include "fmu.h"

typedef struct {
  void (*logger)(void *, String, Status, String, String, ...);
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void (*finished)(void *, Status);
  void *environment;
} Callbacks;

static void tell(const fmu_t *f, int status, const char *text) {
  void (*logger)(void *, String, Status, String, String, ...);
  memcpy(&logger, &f->logger, sizeof logger);
  logger(f->environment, f->name, status, "logStatusError", "%s", text);
}

String fmi2GetTypesPlatform(void) { return "default"; }
String fmi2GetVersion(void) { return "2.0"; }

Component fmi2Instantiate(String name, int kind, String token, String place, const Callbacks *calls,
                          int visible, int logging) {
  (void)place, (void)visible;
  if (!calls) return NULL;
  return create(name, kind == 1 ? token : NULL, &calls->logger, calls->environment, logging);
}

Status fmi2SetupExperiment(Component f, int tolerant, double tolerance, double start, int ends,
                           double stop) {
  (void)tolerant, (void)tolerance;
  return allowed(f, CREATED, __func__) ? times(f, start, ends, stop) : ERROR;
}

Status fmi2EnterInitializationMode(Component f) {
  if (!allowed(f, CREATED, __func__)) return ERROR;
  f->now.phase = INITIALISING;
  return OK;
}

#define ACCESS(Type, name, kind)                                                         \
  Status fmi2Get##name(Component f, const Reference v[], size_t count, Type x[]) {       \
    double value;                                                                        \
    if (!allowed(f, ANY & ~CREATED, __func__) || (count && (!v || !x))) return ERROR;    \
    for (size_t i = 0; i < count; x[i++] = (Type)value)                                  \
      if (get(f, v[i], kind, &value)) return ERROR;                                      \
    return OK;                                                                           \
  }                                                                                      \
  Status fmi2Set##name(Component f, const Reference v[], size_t count, const Type x[]) { \
    if (!allowed(f, SETTABLE, __func__) || (count && (!v || !x))) return ERROR;          \
    for (size_t i = 0; i < count; i++)                                                   \
      if (set(f, v[i], kind, (double)x[i])) return ERROR;                                \
    return OK;                                                                           \
  }

ACCESS(double, Real, REAL)
ACCESS(int, Integer, INTEGER)
ACCESS(int, Boolean, BOOLEAN)

Status fmi2DoStep(Component f, double time, double size, int fixed) {
  (void)fixed;
  return allowed(f, STEPPING, __func__) ? advance(f, time, size) : ERROR;
}

NONE(fmi2GetString)
NONE(fmi2SetString)
NONE(fmi2GetDirectionalDerivative)
NONE(fmi2SetRealInputDerivatives)
NONE(fmi2GetRealOutputDerivatives)
NONE(fmi2CancelStep)
NONE(fmi2GetStatus)
NONE(fmi2GetRealStatus)
NONE(fmi2GetIntegerStatus)
NONE(fmi2GetBooleanStatus)
NONE(fmi2GetStringStatus)
