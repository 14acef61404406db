/* One leg is asked to move by an inch while all stand still: what the law commands. */
#include <stdio.h>

#include "cmf_law.h"

int main(void) {
  cmf_law law;
  cmf_law_input input = {{0.0}};
  cmf_law_output output;
  cmf_law_start(&law);
  input.reference[0] = 0.0254;
  for (int frame = 0; frame < 2048; frame++) {
    cmf_law_step(&law, &input, &output);
    if (frame % 256 == 0)
      printf("%.3f s  leg 1 %+.4f  leg 2 %+.4f of full command\n", frame / 2048.0,
             output.command[0], output.command[1]);
  }
  return 0;
}
