/* Calls a function of machine code as XLA does (xla/ffi/api/c_api.h), for an emulated processor:
     native_host N_ARGUMENTS N_RESULTS < SIZE NUMBER...
   One result; prints its numbers exactly. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void *program(void *frame);

int main(int n, char **words) {
  int n_arguments = atoi(words[1]), n_results = atoi(words[2]);
  static char frame[256], buffers[16][64], result[64];
  static void *arguments[16], *results[1];
  for (int i = 0; i < n_arguments; i++) {
    int size;
    if (scanf("%d", &size) != 1) return 3;
    double *numbers = malloc(sizeof(double) * size);
    for (int k = 0; k < size; k++)
      if (scanf("%la", &numbers[k]) != 1) return 4;
    memcpy(buffers[i] + 24, &numbers, sizeof numbers);
    arguments[i] = buffers[i];
  }
  double *found = calloc(n_results, sizeof(double));
  memcpy(result + 24, &found, sizeof found);
  results[0] = result;
  void *all_arguments = arguments, *all_results = results;
  memcpy(frame + 72, &all_arguments, sizeof(void *));
  memcpy(frame + 112, &all_results, sizeof(void *));
  if (program(frame)) return 5;
  for (int k = 0; k < n_results; k++) printf("%a\n", found[k]);
  return 0;
}
