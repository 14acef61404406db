/* ------------------------------------------------------------------------------------------------
 * Inverse of the machine: the commands that make the planned motion,
 * F = M_leg l'', z = l' + K^-1 (F' + lambda F), k u = (1 + d/dt / a) (1 + d/dt / b) z.
 */
#define SPEED @dcl.plan.inverse.speed@ /* k [m/s of full command] @law.plan.speed@ in/s/% */
#define SPRING @dcl.plan.inverse.spring@ /* K of a leg at neutral [N/m], or 1 for masses over it */
#define LEAK_RATE @dcl.plan.inverse.leak_rate@ /* lambda [1/s] */
/* Corners a and b of drive and valve are @law.plan.drive_lag@ and @law.plan.valve_lag@ Hz. */
#define LAGS @dcl.plan.inverse.lag_sum@ /* 1/a + 1/b [s] */
#define LAGS_PRODUCT @dcl.plan.inverse.lag_product@ /* 1/(a b) [s^2] */
#if STALLS
#define STALL @dcl.plan.inverse.stall@ /* F_s [N] @law.plan.stall@ klbf */
#define NEAR_STALL @near_stall@ /* share of it to which loads are bent */
#define SMALL_FLOW @small_flow@ /* [m/s] about which a change of direction is rounded */
#endif
#if !FOLLOWS

/* Masses over their springs, times SPRING: SPRING / w^2. */
static const cmf_real PLAN_MASS[LEGS] = @plan_mass@;
#endif

/* Forces of the legs that the motion asks for, and three derivatives. */
#if FOLLOWS
static void plan_forces(cmf_real pose[LEGS], const motion *legs, derivatives *force) {
  matrix reciprocal;
  follow_pose(pose, legs->of[0], &reciprocal);
  for (int row = 0; row < 4; row++) {
    cmf_real twist[LEGS];
    cmf_real pushed[LEGS];
    times(&reciprocal, legs->of[row + 2], twist);
    times(&INERTIA, twist, pushed);
    transposed_times(&reciprocal, pushed, force->of[row]);
  }
}
#else
static void plan_forces(const motion *mean, derivatives *force) {
  for (int row = 0; row < 4; row++) {
#if MODAL
    cmf_real modes[LEGS];
    for (int mode = 0; mode < LEGS; mode++) {
      modes[mode] = PLAN_MASS[mode] * mean->of[row + 2][mode];
    }
    to_legs(modes, force->of[row]);
#else
    for (int leg = 0; leg < LEGS; leg++) {
      force->of[row][leg] = PLAN_MASS[leg] * mean->of[row + 2][leg];
    }
#endif
  }
}
#endif

#if STALLS
typedef struct {
  cmf_real more; /* [m/s] */
  cmf_real rate; /* [m/s^2] */
} opening;

/* What a valve opens beyond the flow asked of it, z / sqrt(1 - F sgn(z) / F_s), for its load. */
static opening opened(cmf_real flow, cmf_real flow_rate, cmf_real load, cmf_real load_rate) {
  opening found;
  const cmf_real share = load / STALL;
  const cmf_real near = share / NEAR_STALL;
  const cmf_real bend = 1.0 / (1.0 + (near * near));
  const cmf_real change = ((bend * sqrt(bend)) * load_rate) / STALL;
  const cmf_real bent = share * sqrt(bend);
  const cmf_real out = 1.0 / sqrt(1.0 - bent);
  const cmf_real back = 1.0 / sqrt(1.0 + bent);
  const cmf_real mean = (0.5 * (out + back)) - 1.0;
  const cmf_real half = 0.5 * (out - back);
  const cmf_real root = sqrt((flow * flow) + (SMALL_FLOW * SMALL_FLOW));
  const cmf_real size = (flow * flow) / root;
  const cmf_real slope = (flow * ((flow * flow) + ((2.0 * SMALL_FLOW) * SMALL_FLOW))) /
                         ((root * root) * root);
  const cmf_real up = ((0.5 * out) * out) * out;
  const cmf_real down = ((0.5 * back) * back) * back;
  found.more = (mean * flow) + (half * size);
  found.rate = (mean + (half * slope)) * flow_rate;
  found.rate += (0.5 * (((up - down) * flow) + ((up + down) * size))) * change;
  return found;
}

#endif
static cmf_real valve_inverse(const motion *legs, const derivatives *force, int leg) {
#if FOLLOWS
  const oil here = oil_at(legs->of[0][leg] / HALF_STROKE);
  const cmf_real spring = SPRING * here.spring;
  const cmf_real leak = LEAK_RATE * here.leak;
#else
  const cmf_real spring = SPRING;
  const cmf_real leak = LEAK_RATE;
#endif
  const cmf_real y2 = force->of[0][leg] / spring;
  const cmf_real y3 = force->of[1][leg] / spring;
  const cmf_real y4 = force->of[2][leg] / spring;
  const cmf_real y5 = force->of[3][leg] / spring;
  const cmf_real flow = (legs->of[1][leg] + y3) + (leak * y2);
  const cmf_real first = (legs->of[2][leg] + y4) + (leak * y3);
  const cmf_real second = (legs->of[3][leg] + y5) + (leak * y4);
#if STALLS
  const opening load = opened(flow, first, force->of[0][leg], force->of[1][leg]);
  const cmf_real total = ((flow + load.more) + (LAGS * (first + load.rate))) +
                         (LAGS_PRODUCT * second);
#else
  const cmf_real total = (flow + (LAGS * first)) + (LAGS_PRODUCT * second);
#endif
  return total / SPEED;
}

#if MODAL
static void motion_to_legs(const motion *modes, motion *legs) {
  for (int row = 0; row <= ORDER; row++) {
    to_legs(modes->of[row], legs->of[row]);
  }
}

#endif
/* The plan's part of the outputs; the plan moves on. */
static void plan_calculations(cmf_law_state *state, const cmf_real reference[LEGS],
                              const cmf_law_feedback *feedback, cmf_real output[LEGS]) {
  derivatives ahead;
  derivatives force = {0};
  motion mean;
  cmf_real command[LEGS];
#if MODAL
  motion legs = {0};
  cmf_real asked[LEGS];
#endif
  for (int leg = 0; leg < LEGS; leg++) {
    plan_ahead(state, leg, reference[leg], &ahead, &mean);
  }
#if MODAL
  motion_to_legs(&mean, &legs);
#if FOLLOWS
  plan_forces(state->plan.pose, &legs, &force);
#else
  plan_forces(&mean, &force);
#endif
  for (int leg = 0; leg < LEGS; leg++) {
    asked[leg] = valve_inverse(&legs, &force, leg);
  }
  to_modes(asked, command);
#else
  plan_forces(&mean, &force);
  for (int leg = 0; leg < LEGS; leg++) {
    command[leg] = valve_inverse(&mean, &force, leg);
  }
#endif
  for (int leg = 0; leg < LEGS; leg++) {
    output[leg] += command[leg] + plan_correction(state, leg, feedback);
    plan_advance(state, leg, &ahead);
  }
}
