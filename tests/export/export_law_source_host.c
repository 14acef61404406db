/* Runs a law's source on rows of inputs: host IN OUT. Numbers are doubles, the least byte first,
 * on any processor. IN has the states, then rows of reference and feedback; OUT has a row of output
 * and command each, then the states. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "cmf_law.h"

static int take(FILE *file, cmf_real *values, size_t count) {
  unsigned char bytes[8];
  for (size_t i = 0; i < count; i++) {
    uint64_t word = 0;
    double value;
    if (!fread(bytes, 8, 1, file)) return 0;
    for (int k = 0; k < 8; k++) word |= (uint64_t)bytes[k] << (8 * k);
    memcpy(&value, &word, 8);
    values[i] = (cmf_real)value;
  }
  return 1;
}

static void put(FILE *file, const cmf_real *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    double value = values[i];
    uint64_t word;
    memcpy(&word, &value, 8);
    for (int k = 0; k < 8; k++) fputc((int)(word >> (8 * k) & 255), file);
  }
}

int main(int count, char **words) {
  static cmf_law law;
  static cmf_law_input input;
  cmf_law_output output;
  size_t states = sizeof law.state / sizeof(cmf_real);
  FILE *in = fopen(words[count - 2], "rb"), *out = fopen(words[count - 1], "wb");
  if (!in || !out) return 3;
  if (cmf_law_start(&law, CMF_LAW_RATE + 1) || !cmf_law_start(&law, CMF_LAW_RATE)) return 4;
  if (!take(in, (cmf_real *)&law.state, states)) return 5;
  while (take(in, (cmf_real *)&input, sizeof input / sizeof(cmf_real))) {
    cmf_law_step(&law, &input, &output);
    put(out, (cmf_real *)&output, 2 * CMF_LAW_LEGS);
  }
  put(out, (cmf_real *)&law.state, states);
  return fclose(out);
}
