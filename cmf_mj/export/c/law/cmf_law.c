#include "cmf_law.h"

#include <string.h>

extern const unsigned char cmf_law_slots_data[], cmf_law_memory_data[];
int cmf_law_code(void **, void **, int64_t, int64_t, int64_t);

static const struct {
  const char *name;
  int slot;
} states[] = {CMF_LAW_STATES};

static const int pointers[] = {CMF_LAW_POINTERS};
static const int inputs[] = {CMF_LAW_INPUTS};

/* The table of slots with the addresses of the memory, wherever that may be by now. */
static void place(cmf_law *law) {
  memcpy(law->slots, cmf_law_slots_data, sizeof law->slots);
  for (unsigned i = 0; i < sizeof pointers / sizeof *pointers; i++)
    law->slots[pointers[i]] += (int64_t)(intptr_t)law->memory;
}

static double *numbers(const cmf_law *law, int slot) {
  return (double *)(intptr_t)law->slots[slot];
}

void cmf_law_start(cmf_law *law) {
  memcpy(law->memory, cmf_law_memory_data, sizeof law->memory);
  place(law);
}

void cmf_law_step(cmf_law *law, const cmf_law_input *input, cmf_law_output *output) {
  void *result, *fault;
  place(law);
  for (int i = 0; i < 6; i++)
    memcpy(numbers(law, inputs[i]), (const double *)input + i * CMF_LAW_LEGS, 8 * CMF_LAW_LEGS);
  cmf_law_code(&result, &fault, (int64_t)(intptr_t)law->slots, 0, 0);
  memcpy(output->output, numbers(law, CMF_LAW_OUTPUT), sizeof output->output);
  memcpy(output->command, numbers(law, CMF_LAW_COMMAND), sizeof output->command);
}

int cmf_law_states(void) { return sizeof states / sizeof *states; }

const char *cmf_law_state_name(int i) {
  return i < 0 || i >= cmf_law_states() ? 0 : states[i].name;
}

double *cmf_law_state(cmf_law *law, int i) {
  if (i < 0 || i >= cmf_law_states()) return 0;
  place(law);
  return numbers(law, states[i].slot);
}
