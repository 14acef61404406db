/* FMI 3.0 for co-simulation. */
#include <stdbool.h>

#define FMI(name) fmi3##name
#define GET_STATE fmi3GetFMUState
#define SET_STATE fmi3SetFMUState
#define FREE_STATE fmi3FreeFMUState
#define STATE_SIZE fmi3SerializedFMUStateSize
#define SERIALIZE fmi3SerializeFMUState
#define DESERIALIZE fmi3DeserializeFMUState
#define SWITCH bool
#include "fmu.h"

typedef void (*Logger)(void *, Status, String, String);

static void tell(const fmu_t *f, int status, const char *text) {
  Logger logger;
  memcpy(&logger, &f->logger, sizeof logger);
  logger(f->environment, status, "logStatusError", text);
}

String fmi3GetVersion(void) { return "3.0"; }

Component fmi3InstantiateCoSimulation(String name, String token, String place, bool visible,
                                      bool logging, bool events, bool early,
                                      const Reference between[], size_t count, void *environment,
                                      Logger logger, void (*update)(void)) {
  (void)place, (void)visible, (void)events, (void)early, (void)between, (void)count, (void)update;
  return create(name, token, &logger, environment, logging);
}

Status fmi3EnterInitializationMode(Component f, bool tolerant, double tolerance, double start,
                                   bool ends, double stop) {
  (void)tolerant, (void)tolerance;
  if (!allowed(f, CREATED, __func__) || times(f, start, ends, stop)) return ERROR;
  f->now.phase = INITIALISING;
  return OK;
}

#define ACCESS(Type, name, kind)                                                                  \
  Status fmi3Get##name(Component f, const Reference v[], size_t count, Type x[], size_t size) {   \
    double value;                                                                                 \
    if (!allowed(f, ANY & ~CREATED, __func__)) return ERROR;                                      \
    if (size != count || (count && (!v || !x))) return fail(f, ERROR, "values: too many or few"); \
    for (size_t i = 0; i < count; x[i++] = (Type)value)                                           \
      if (get(f, v[i], kind, &value)) return ERROR;                                               \
    return OK;                                                                                    \
  }                                                                                               \
  Status fmi3Set##name(Component f, const Reference v[], size_t count, const Type x[],            \
                       size_t size) {                                                             \
    if (!allowed(f, SETTABLE, __func__)) return ERROR;                                            \
    if (size != count || (count && (!v || !x))) return fail(f, ERROR, "values: too many or few"); \
    for (size_t i = 0; i < count; i++)                                                            \
      if (set(f, v[i], kind, (double)x[i])) return ERROR;                                         \
    return OK;                                                                                    \
  }

ACCESS(double, Float64, REAL)
ACCESS(int32_t, Int32, INTEGER)
ACCESS(bool, Boolean, BOOLEAN)

Status fmi3DoStep(Component f, double time, double size, bool fixed, bool *event, bool *terminate,
                  bool *early, double *last) {
  (void)fixed;
  if (!allowed(f, STEPPING, __func__)) return ERROR;
  Status status = advance(f, time, size);
  if (event) *event = false;
  if (terminate) *terminate = false;
  if (early) *early = false;
  if (last) *last = f->now.time;
  return status;
}

void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void) { return NULL; }

#define NEITHER(name) NONE(fmi3Get##name) NONE(fmi3Set##name)
NEITHER(Float32)
NEITHER(Int8)
NEITHER(UInt8)
NEITHER(Int16)
NEITHER(UInt16)
NEITHER(UInt32)
NEITHER(Int64)
NEITHER(UInt64)
NEITHER(String)
NEITHER(Binary)
NEITHER(Clock)
NEITHER(IntervalDecimal)
NEITHER(IntervalFraction)
NEITHER(ShiftDecimal)
NEITHER(ShiftFraction)
NONE(fmi3EnterEventMode)
NONE(fmi3EnterStepMode)
NONE(fmi3EnterContinuousTimeMode)
NONE(fmi3EnterConfigurationMode)
NONE(fmi3ExitConfigurationMode)
NONE(fmi3CompletedIntegratorStep)
NONE(fmi3SetTime)
NONE(fmi3SetContinuousStates)
NONE(fmi3GetContinuousStates)
NONE(fmi3GetContinuousStateDerivatives)
NONE(fmi3GetEventIndicators)
NONE(fmi3GetNominalsOfContinuousStates)
NONE(fmi3GetNumberOfEventIndicators)
NONE(fmi3GetNumberOfContinuousStates)
NONE(fmi3GetNumberOfVariableDependencies)
NONE(fmi3GetVariableDependencies)
NONE(fmi3GetDirectionalDerivative)
NONE(fmi3GetAdjointDerivative)
NONE(fmi3EvaluateDiscreteStates)
NONE(fmi3UpdateDiscreteStates)
NONE(fmi3GetOutputDerivatives)
NONE(fmi3ActivateModelPartition)
