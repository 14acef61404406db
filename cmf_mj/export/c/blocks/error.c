/* ------------------------------------------------------------------------------------------------
 * Error calculations: rates d = p (s - z), z[k+1] = z[k] + T d of the error and of the target, and
 * the error's integral with its saturation. Errors count from the target:
 * @errors_from@.
 */
#define DERIVATIVE_POLE @dcl.error.derivative_pole@ /* p [rad/s] */
#define INTEGRATOR_LIMIT @dcl.error.integrator_limit@ /* [m s] @law.integrator_limit@ in s */
#define INTEGRATOR_TRIGGER @dcl.error.integrator_trigger@ /* [m] */

static cmf_real filtered_rate(cmf_real signal, cmf_real filter[LEGS], int leg) {
  const cmf_real rate = DERIVATIVE_POLE * (signal - filter[leg]);
  filter[leg] = filter[leg] + (FRAME * rate);
  return rate;
}

static void error_calculations(cmf_law_state *state, const cmf_real reference[LEGS],
                               const cmf_real target[LEGS], const cmf_real integral[LEGS],
                               signals *u) {
  for (int leg = 0; leg < LEGS; leg++) {
    const cmf_real error = target[leg] - u->of[POSITION][leg];
    u->of[REFERENCE][leg] = reference[leg];
    u->of[POSITION_ERROR_RATE][leg] = filtered_rate(error, state->error.position_filter, leg);
    u->of[VELOCITY_ERROR][leg] =
        filtered_rate(target[leg], state->error.reference_filter, leg) - u->of[VELOCITY][leg];
    u->of[ERROR_INTEGRAL][leg] = integral[leg];
  }
}

/* Below the trigger the integral sees the lower end of the stroke. */
static void integrate_errors(cmf_real integral[LEGS], const cmf_real target[LEGS],
                             const cmf_real position[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    const cmf_real seen = (position[leg] > INTEGRATOR_TRIGGER) ? position[leg] : -TRAVEL;
    const cmf_real moved = integral[leg] + (FRAME * (target[leg] - seen));
    integral[leg] = within(moved, -INTEGRATOR_LIMIT, INTEGRATOR_LIMIT);
  }
}
