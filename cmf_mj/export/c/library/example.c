/* Heave by a decimetre in one second, then lose the pump; print what the machine does. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cmf.h"

static int failure(const char *name) {
  for (int i = 0; i < cmf_failures(); i++)
    if (!strcmp(cmf_failure_at(i)->name, name)) return i;
  return -1;
}

int main(void) {
  cmf_machine *machine = cmf_create();
  if (!machine) return fprintf(stderr, "no memory, or another version of MuJoCo\n"), 1;
  const cmf_channel_info *supply = cmf_find_channel("supply_pressure");
  const cmf_channel_info *legs = cmf_find_channel("leg_extension");
  if (cmf_inject(machine, failure("pump_lost"), 2.0, 0, 0, 0.0))
    fprintf(stderr, "%s\n", cmf_message(machine));

  for (int frame = 0; frame < 4 * 2048; frame++) {
    double t = frame / CMF_RATE, x = t < 1.0 ? t : 1.0;
    double pose[6] = {0.0, 0.0, -0.1 * x * x * x * (10.0 - 15.0 * x + 6.0 * x * x), 0.0, 0.0, 0.0};
    if (cmf_set_pose(machine, pose) || cmf_step(machine, 1)) {
      fprintf(stderr, "%s\n", cmf_message(machine));
      break;
    }
    if (frame % 1024 == 0)
      printf("%4.1f s  leg 1 %+8.5f %s  supply %6.2f MPa\n", t, cmf_channel(machine, legs)[0],
             legs->unit, 1e-6 * cmf_channel(machine, supply)[0]);
  }
  cmf_free(machine);
  return 0;
}
