/* An OpenCL, or a disk, that fails: preloaded, it lets calls through until the one that MHSPLAT_FAULT names, as NAME:NUMBER:ERROR, and
 * answers that one and all later ones of its name with the error. A lost device stays lost. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* The error, if this call has one. */
static int fault(const char *name, atomic_long *calls) {
  const char *wanted = getenv("MHSPLAT_FAULT");
  size_t n = strlen(name);
  if (!wanted || strncmp(wanted, name, n) != 0 || wanted[n] != ':')
    return 0;
  char *rest;
  long number = strtol(wanted + n + 1, &rest, 10);
  return atomic_fetch_add(calls, 1) + 1 >= number ? atoi(rest + 1) : 0;
}

#define NEXT(name) ((typeof(&name))dlsym(RTLD_NEXT, #name))

#define INTERPOSE(name, parameters, arguments)                                 \
  int name parameters {                                                        \
    static atomic_long calls;                                                  \
    int error = fault(#name, &calls);                                          \
    return error ? error : NEXT(name) arguments;                               \
  }

typedef const void *list;

INTERPOSE(clEnqueueNDRangeKernel,
          (void *queue, void *kernel, unsigned dims, const size_t *offset, const size_t *global, const size_t *local,
           unsigned n, list wait, void *event),
          (queue, kernel, dims, offset, global, local, n, wait, event))
INTERPOSE(clEnqueueReadBuffer,
          (void *queue, void *mem, unsigned blocking, size_t offset, size_t size, void *to, unsigned n, list wait, void *event),
          (queue, mem, blocking, offset, size, to, n, wait, event))
INTERPOSE(clEnqueueCopyBuffer,
          (void *queue, void *from, void *to, size_t at, size_t onto, size_t size, unsigned n, list wait, void *event),
          (queue, from, to, at, onto, size, n, wait, event))
INTERPOSE(clEnqueueFillBuffer,
          (void *queue, void *mem, list pattern, size_t length, size_t offset, size_t size, unsigned n, list wait,
           void *event),
          (queue, mem, pattern, length, offset, size, n, wait, event))
INTERPOSE(clFlush, (void *queue), (queue))
INTERPOSE(clBuildProgram, (void *program, unsigned n, list devices, const char *options, void *notify, void *data),
          (program, n, devices, options, notify, data))
INTERPOSE(clCreateSubDevices, (void *device, list properties, unsigned n, void *devices, unsigned *made),
          (device, properties, n, devices, made))
INTERPOSE(clWaitForEvents, (unsigned n, list events), (n, events))

void *clCreateBuffer(void *context, unsigned long flags, size_t size, void *host, int *error) {
  static atomic_long calls;
  int failed = fault("clCreateBuffer", &calls);
  if (!failed)
    return NEXT(clCreateBuffer)(context, flags, size, host, error);
  if (error)
    *error = failed;
  return NULL;
}

/* Reads at a place in a file; the error is one of errno. */
ssize_t pread64(int file, void *to, size_t size, off64_t at) {
  static atomic_long calls;
  int error = fault("pread64", &calls);
  if (!error)
    return NEXT(pread64)(file, to, size, at);
  errno = error;
  return -1;
}
