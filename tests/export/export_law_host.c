/* Replays recorded feedback through an exported law: host IN OUT; IN is the states, then rows of
 * inputs; OUT is the compensator's output, row by row. */
#include <stdio.h>
#include <string.h>

#include "cmf_law.h"

int main(int count, char **words) {
  cmf_law law;
  cmf_law_input input;
  cmf_law_output output;
  FILE *in = fopen(words[count - 2], "rb"), *out = fopen(words[count - 1], "wb");
  if (!in || !out) return 3;
  cmf_law_start(&law);
  for (int i = 0; i < cmf_law_states(); i++)
    if (!fread(cmf_law_state(&law, i), 8 * CMF_LAW_LEGS, 1, in)) return 4;
  while (fread(&input, sizeof input, 1, in)) {
    cmf_law moved = law; /* it may stand anywhere */
    memset(&law, 0, sizeof law);
    cmf_law_step(&moved, &input, &output);
    law = moved;
    fwrite(output.output, sizeof output.output, 1, out);
  }
  return fclose(out);
}
