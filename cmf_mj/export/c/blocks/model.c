/* ------------------------------------------------------------------------------------------------
 * Reference model a = w^2 (r - p) - 2 zeta w v, advanced exactly, and its feed-forward
 * (1 + d) (K_v v + K_a a) + K_p (p - measured) + K_r (v - measured).
 */
#define POSITION_STAYS @dcl.model.position_of_position@ /* next p of p */
#define POSITION_OF_VELOCITY @dcl.model.position_of_velocity@ /* [s] of v */
#define POSITION_OF_REFERENCE @dcl.model.position_of_reference@ /* of r */
#define VELOCITY_OF_POSITION @dcl.model.velocity_of_position@ /* [1/s] next v of p */
#define VELOCITY_STAYS @dcl.model.velocity_of_velocity@ /* of v */
#define VELOCITY_OF_REFERENCE @dcl.model.velocity_of_reference@ /* [1/s] of r */
#define MODEL_POSITION_GAIN @dcl.model.position_gain@ /* K_p [1/m], @law.reference_model.position@ %/in */
#define MODEL_RATE_GAIN @dcl.model.rate_gain@ /* K_r [s/m], @law.reference_model.rate@ %/(in/s) */
#define MODEL_VELOCITY_GAIN @dcl.model.velocity_gain@ /* K_v [s/m], @law.reference_model.velocity@ %/(in/s) */
#define MODEL_ACCELERATION_GAIN @dcl.model.acceleration_gain@ /* K_a [s^2/m], @law.reference_model.acceleration@ %/(in/s^2) */
#if ADAPTING
#define ADAPTATION_GAIN @dcl.model.adaptation_gain@ /* @law.reference_model.adaptation.rate@ 1/s K_v T [1/m] */
#define SLOPE @dcl.model.slope@ /* [1/s] */
#define FILTER_STAYS @dcl.model.filter_pole@ /* low-pass of @law.reference_model.adaptation.corner@ Hz */
#define LEVEL @dcl.model.level@ /* [fraction] @law.reference_model.adaptation.level@ % */
#define DEAD_ZONE @dcl.model.dead_zone@ /* [m/s] @law.reference_model.adaptation.dead_zone@ in/s */
#define LEAK @dcl.model.leak@ /* a frame */
#define LOWEST @dcl.model.lowest@ /* of d */
#define HIGHEST @dcl.model.highest@
#endif

#if ADAPTING
/* Adaptation of d: it learns from s = (v - measured) + slope (p - measured), low-passed. */
static void adapt(cmf_law_state *state, int leg, cmf_real feed_forward, cmf_real error,
                  cmf_real rate) {
  const cmf_real passes = 1.0 - FILTER_STAYS;
  const cmf_real combined = (FILTER_STAYS * state->model.adaptation.error[leg]) +
                            (passes * (rate + (SLOPE * error)));
  const cmf_real filtered =
      (FILTER_STAYS * state->model.adaptation.feed_forward[leg]) + (passes * feed_forward);
  const cmf_real power = (FILTER_STAYS * state->model.adaptation.power[leg]) +
                         ((passes * feed_forward) * feed_forward);
  const cmf_real learned = combined - within(combined, -DEAD_ZONE, DEAD_ZONE);
  cmf_real moved = (1.0 - LEAK) * state->model.adaptation.factor[leg];
  moved += ((ADAPTATION_GAIN * learned) * filtered) / ((LEVEL * LEVEL) + power);
  state->model.adaptation.factor[leg] = within(moved, LOWEST, HIGHEST);
  state->model.adaptation.error[leg] = combined;
  state->model.adaptation.feed_forward[leg] = filtered;
  state->model.adaptation.power[leg] = power;
}

#endif
static void reference_model(cmf_law_state *state, const cmf_real reference[LEGS],
                            const cmf_law_feedback *feedback, cmf_real output[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    const cmf_real position = state->model.position[leg];
    const cmf_real velocity = state->model.velocity[leg];
    const cmf_real following =
        ((VELOCITY_OF_POSITION * position) + (VELOCITY_STAYS * velocity)) +
        (VELOCITY_OF_REFERENCE * reference[leg]);
    const cmf_real acceleration = (following - velocity) / FRAME;
    const cmf_real feed_forward =
        (MODEL_VELOCITY_GAIN * velocity) + (MODEL_ACCELERATION_GAIN * acceleration);
    const cmf_real error = position - feedback->position[leg];
    const cmf_real rate = velocity - feedback->velocity[leg];
#if ADAPTING
    cmf_real total = output[leg] + ((1.0 + state->model.adaptation.factor[leg]) * feed_forward);
#else
    cmf_real total = output[leg] + feed_forward;
#endif
    total += (MODEL_POSITION_GAIN * error) + (MODEL_RATE_GAIN * rate);
#if ADAPTING
    if (fabs(total) < 1.0) {
      adapt(state, leg, feed_forward, error, rate);
    }
#endif
    state->model.position[leg] =
        ((POSITION_STAYS * position) + (POSITION_OF_VELOCITY * velocity)) +
        (POSITION_OF_REFERENCE * reference[leg]);
    state->model.velocity[leg] = following;
    output[leg] = total;
  }
}
