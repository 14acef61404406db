/* A law's source in a loop around an exported machine without law: host IN OUT. IN has the law's
 * states, then a row of references a frame; OUT has a row of extensions and commands each. */
#include <stdio.h>

#include "cmf.h"
#include "cmf_law.h"

static void read(const cmf_machine *m, const char *name, double *values) {
  const double *channel = cmf_channel(m, cmf_find_channel(name));
  for (int leg = 0; leg < CMF_LAW_LEGS; leg++) values[leg] = channel[leg];
}

int main(int count, char **words) {
  static cmf_law law;
  cmf_law_input input;
  cmf_law_output output;
  cmf_machine *m = cmf_create();
  FILE *in = fopen(words[count - 2], "rb"), *out = fopen(words[count - 1], "wb");
  if (!m || !in || !out || !cmf_law_start(&law, (int)CMF_RATE)) return 3;
  if (!fread(&law.state, sizeof law.state, 1, in)) return 4;
  while (fread(input.reference, sizeof input.reference, 1, in)) {
    if (cmf_step(m, 1)) return puts(cmf_message(m)), 5;
    read(m, "leg_position", input.feedback.position);
    read(m, "leg_velocity", input.feedback.velocity);
    read(m, "leg_acceleration", input.feedback.acceleration);
    read(m, "cap_pressure", input.feedback.cap_pressure);
    read(m, "rod_pressure", input.feedback.rod_pressure);
    cmf_law_step(&law, &input, &output);
    if (cmf_set_reference(m, output.command)) return puts(cmf_message(m)), 6;
    fwrite(cmf_channel(m, cmf_find_channel("leg_extension")), 8, CMF_LAW_LEGS, out);
    fwrite(output.command, sizeof output.command, 1, out);
  }
  return cmf_free(m), fclose(out);
}
