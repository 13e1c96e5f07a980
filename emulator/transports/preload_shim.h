/* What the parts of the preload shim know of each other. */
#ifndef LIDAREMU_PRELOAD_SHIM_H
#define LIDAREMU_PRELOAD_SHIM_H

#define HIDDEN __attribute__((visibility("hidden")))

/* The function of that name behind the shim, looked up once and kept; NULL: there is none. */
HIDDEN void *next_symbol(void **kept, const char *name);

/* ioctl of the C library, or of what else is preloaded. */
HIDDEN int next_ioctl(int fd, unsigned long request, void *argument);

/* Says on standard error, once in a program, that the shim is there. */
HIDDEN void say_active(void);

/* Answers a call about a CAN socket or one of our CAN interfaces; 0: it is about neither. */
HIDDEN int can_ioctl(int fd, unsigned long request, void *argument, int *result);

/* Reads the environment: which CAN interfaces there are. */
HIDDEN void can_start(void);

/* Names of our CAN interfaces with a blank before each; "": none. */
HIDDEN const char *can_names(void);

#endif
