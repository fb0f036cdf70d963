/* Co-simulates the library of an FMU (FMI 3.0), 20 steps of 20 ms, and prints its numbers exactly:
     fmu_host LIBRARY TOKEN REFERENCE...
   For libraries of other systems, which FMPy cannot load: under qemu-user or Wine. */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#if defined(_WIN32)
#include <windows.h>
#define OPEN(name) LoadLibraryA(name)
#define FIND(library, name) (void *)GetProcAddress(library, name)
#else
#include <dlfcn.h>
#define OPEN(name) dlopen(name, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif
typedef void *(*New)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t, void *,
                     void *, void *);
typedef int (*Begin)(void *, bool, double, double, bool, double);
typedef int (*End)(void *);
typedef int (*Step)(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int (*Get)(void *, const uint32_t *, size_t, double *, size_t);
static void logged(void *e, int s, const char *c, const char *m) { fprintf(stderr, "%s\n", m); }
int main(int n, char **words) {
  void *library = OPEN(words[1]);
  if (!library) return 3;
  void *it = ((New)FIND(library, "fmi3InstantiateCoSimulation"))("one", words[2], "", false, true, false, false, NULL, 0, NULL,
                                                                 (void *)logged, NULL);
  if (!it) return 4;
  if (((Begin)FIND(library, "fmi3EnterInitializationMode"))(it, false, 0, 0, false, 0)) return 5;
  if (((End)FIND(library, "fmi3ExitInitializationMode"))(it)) return 6;
  for (int k = 0; k < 20; k++) {
    bool a, b, c;
    double t, y;
    if (((Step)FIND(library, "fmi3DoStep"))(it, k * 0.02, 0.02, true, &a, &b, &c, &t)) return 7;
    for (int i = 3; i < n; i++) {
      uint32_t reference = atoi(words[i]);
      if (((Get)FIND(library, "fmi3GetFloat64"))(it, &reference, 1, &y, 1)) return 8;
      printf("%a\n", y);
    }
  }
  return 0;
}
