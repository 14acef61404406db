/* ------------------------------------------------------------------------------------------------
 * Trajectory plan: a reference of bounded rate, acceleration and jerk, and a motion that follows it
 * through the chosen poles: x[k+1] = A x[k] + B r[k] of position and four derivatives.
 */
#define ORDER 5
#define PLAN_SMOOTH @dcl.plan.bend_share@ /* of the acceleration, a frame: @law.plan.smooth@ Hz */
#define PLAN_PULL @dcl.plan.approach@ /* p, a frame: @law.plan.approach@ Hz */

/* A and B: poles of @law.plan.pairs@ [Hz, damping ratio] and @law.plan.pole@ Hz. */
static const cmf_real PLAN_TRANSITION[ORDER][ORDER] = @dcl.plan.transition@;
static const cmf_real PLAN_INPUT[ORDER] = @dcl.plan.input@;

/* Fastest reference [m a frame]: @law.plan.rate@ in/s. */
static const cmf_real PLAN_RATE[LEGS] = @dcl.plan.rate@;

/* Its largest change in a frame [m a frame]: @law.plan.acceleration@ in/s^2. */
static const cmf_real PLAN_ACCELERATION[LEGS] = @dcl.plan.acceleration@;

/* K_p [1/m]: @law.plan.position@ %/in. */
static const cmf_real PLAN_POSITION_GAIN[LEGS] = @dcl.plan.position_gain@;

/* K_r [s/m]: @law.plan.velocity@ %/(in/s). */
static const cmf_real PLAN_VELOCITY_GAIN[LEGS] = @dcl.plan.velocity_gain@;

typedef struct {
  cmf_real of[ORDER][LEGS];
} derivatives;

typedef struct {
  cmf_real of[ORDER + 1][LEGS];
} motion;

/* Rate at which to close an error: a line, then a root that keeps the deceleration `most`. */
static cmf_real approach(cmf_real error, cmf_real most) {
  const cmf_real size = fabs(error);
  const cmf_real near = most / (PLAN_PULL * PLAN_PULL);
  cmf_real rate;
  if (size <= (4.0 * near)) {
    rate = (0.5 * PLAN_PULL) * size;
  } else {
    rate = sqrt((2.0 * most) * (size - (2.0 * near)));
  }
  return (error < 0.0) ? -rate : rate;
}

/* Move the reference on by a frame. */
static void plan_reference(cmf_law_state *state, int leg, cmf_real demand) {
  const cmf_real fastest = PLAN_RATE[leg];
  const cmf_real most = PLAN_ACCELERATION[leg];
  const cmf_real before = state->plan.demand[leg];
  const cmf_real moved = state->plan.demand_rate[leg];
  const cmf_real moving = within(demand - before, -fastest, fastest);
  const cmf_real rate = state->plan.reference_rate[leg];
  const cmf_real closing = approach(state->plan.reference[leg] - before, most);
  const cmf_real last = state->plan.reference_change[leg];
  const cmf_real jump = PLAN_SMOOTH * most;
  cmf_real change = (moving - moved) - ((2.0 * PLAN_PULL) * ((rate - moved) + closing));
  change = within(change, -most, most);
  change = within(change, last - jump, last + jump);
  const cmf_real after = within(rate + change, -fastest, fastest);
  state->plan.reference_change[leg] = after - rate;
  state->plan.demand[leg] = demand;
  state->plan.demand_rate[leg] = moving;
  state->plan.reference_rate[leg] = after;
  state->plan.reference[leg] += after;
}

/* The motion a frame ahead, and its means over the frame after, position to fifth derivative. */
static void plan_ahead(cmf_law_state *state, int leg, cmf_real demand, derivatives *ahead,
                       motion *mean) {
  const cmf_real held = state->plan.reference[leg];
  for (int row = 0; row < ORDER; row++) {
    cmf_real next = PLAN_TRANSITION[row][0] * state->plan.position[leg];
    next += PLAN_TRANSITION[row][1] * state->plan.velocity[leg];
    next += PLAN_TRANSITION[row][2] * state->plan.acceleration[leg];
    next += PLAN_TRANSITION[row][3] * state->plan.jerk[leg];
    next += PLAN_TRANSITION[row][4] * state->plan.snap[leg];
    next += PLAN_INPUT[row] * held;
    ahead->of[row][leg] = next;
  }
  plan_reference(state, leg, demand);
  for (int row = 0; row < ORDER; row++) {
    cmf_real after = PLAN_INPUT[row] * state->plan.reference[leg];
    for (int j = 0; j < ORDER; j++) {
      after += PLAN_TRANSITION[row][j] * ahead->of[j][leg];
    }
    mean->of[row + 1][leg] = (after - ahead->of[row][leg]) / FRAME;
  }
  mean->of[0][leg] = ahead->of[0][leg] + ((0.5 * FRAME) * mean->of[1][leg]);
}

/* Command for errors from the plan. */
static cmf_real plan_correction(const cmf_law_state *state, int leg,
                                const cmf_law_feedback *feedback) {
  const cmf_real error = state->plan.position[leg] - feedback->position[leg];
  const cmf_real rate = state->plan.velocity[leg] - feedback->velocity[leg];
  return (PLAN_POSITION_GAIN[leg] * error) + (PLAN_VELOCITY_GAIN[leg] * rate);
}

static void plan_advance(cmf_law_state *state, int leg, const derivatives *ahead) {
  state->plan.position[leg] = ahead->of[0][leg];
  state->plan.velocity[leg] = ahead->of[1][leg];
  state->plan.acceleration[leg] = ahead->of[2][leg];
  state->plan.jerk[leg] = ahead->of[3][leg];
  state->plan.snap[leg] = ahead->of[4][leg];
}
