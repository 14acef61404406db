/* ------------------------------------------------------------------------------------------------
 * One control frame: the blocks of Figure 2-6 in signal order.
 */
static void control_frame(cmf_law_state *state, const cmf_law_input *input,
                          cmf_law_output *output) {
  signals u;
  cmf_real limited[LEGS];
#if FOLLOWING
  cmf_real target[LEGS];
#endif
#if MODAL
  cmf_law_feedback modes;
  cmf_real reference[LEGS];
  cmf_real integral[LEGS];
  cmf_real sum[LEGS];
  cmf_real target_of_legs[LEGS];
#endif
  limit_calculations(input->reference, limited);
#if MODAL
  to_modes(limited, reference);
  to_modes(state->error.integral, integral);
  feedback_to_modes(&input->feedback, &modes);
#endif
#if FOLLOWING
  for (int leg = 0; leg < LEGS; leg++) {
    target[leg] = state->@followed@.position[leg];
  }
#endif
  feedback_calculations(state->acceleration, @feedback@, &u);
  error_calculations(state, @reference@, @target@, @integral@, &u);
  compensator_calculations(state->compensator, &u, @sum@);
#if MODELLED
  reference_model(state, @reference@, @feedback@, @sum@);
#endif
#if DAMPED
  load_feedback(state, @feedback@, @sum@);
#endif
#if PLANNED
  plan_calculations(state, @reference@, @feedback@, @sum@);
#endif
#if MODAL
  to_legs(sum, output->output);
  to_legs(@target@, target_of_legs);
  integrate_errors(state->error.integral, target_of_legs, input->feedback.position);
#else
  integrate_errors(state->error.integral, @target@, input->feedback.position);
#endif
  valve_calculations(state->offset, output);
}

int cmf_law_start(cmf_law *law, int rate) {
  static const cmf_law_state engaged = {0};
  law->state = engaged;
  law->started = 0;
  if (rate == CMF_LAW_RATE) {
    law->started = 1;
  }
  return law->started;
}

void cmf_law_step(cmf_law *law, const cmf_law_input *input, cmf_law_output *output) {
  if (law->started == 1) {
    control_frame(&law->state, input, output);
  } else {
    for (int leg = 0; leg < LEGS; leg++) {
      output->output[leg] = 0.0;
      output->command[leg] = 0.0;
    }
  }
}
