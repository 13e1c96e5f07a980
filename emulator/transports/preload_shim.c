/*
 * Preloaded into a driver under test: makes a pseudo-terminal answer as a USB adapter does, to TIOCGSERIAL and TIOCSSERIAL
 * and to the calls about modem lines. (CAN sockets: preload_can.c.)
 *
 * Drivers of the LMS2xx (sicktoolbox, Player, old CARMEN) reach 500 000 baud by ASYNC_SPD_CUST with custom_divisor 48,
 * the divisor of an FTDI adapter's 24 MHz, and then ask termios for B38400. A pseudo-terminal refuses the first two calls.
 * Here they succeed, per terminal and for the life of the process, and while a special speed is set, B38400 becomes
 * that speed (termios2, BOTHER), in whichever order the driver asks; what the driver reads back is B38400.
 *
 * Modem lines (TIOCMGET, TIOCMSET, TIOCMBIS, TIOCMBIC, TIOCMIWAIT, TIOCGICOUNT; mono's SerialPort ends without them): DTR
 * and RTS are up when a port is opened, and the driver's to change; CTS, DSR and CD are those of a device that is there.
 * The emulator is told through a control character that no terminal uses (the last of the kernel's 19), which it reads
 * at its own end, and by an opening of the terminal, which wakes it.
 *
 * Nothing else is touched: other descriptors, other requests and other speeds go straight through.
 * Not covered: statically linked drivers, drivers that call the kernel past the C library, and terminals shared with
 * a process without the shim that changes their speed. Linux with the common ioctl numbers (x86, ARM, RISC-V).
 */
#define _GNU_SOURCE
#include "preload_shim.h"
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/serial.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#if defined(__mips__) || defined(__sparc__) || defined(__alpha__) || defined(__powerpc__) || defined(__hppa__)
#error "this processor numbers its terminal ioctls differently; the shim does not know them"
#endif

/* struct termios2 of linux/asm-generic/termbits.h; that header and <termios.h> cannot be included together. */
struct kernel_termios2 {
    uint32_t c_iflag, c_oflag, c_cflag, c_lflag;
    uint8_t c_line, c_cc[19];
    uint32_t c_ispeed, c_ospeed;
};

enum {
    KERNEL_TERMIOS_SIZE = 36, /* struct termios: the same without the two speeds */
    KERNEL_CBAUD = 0x100F,
    KERNEL_CIBAUD = 0x100F0000,
    KERNEL_BOTHER = 0x1000,
    KERNEL_B38400 = 0x0F,
    ADAPTER_BAUD_BASE = 24000000, /* FTDI: 24 MHz / 48 = 500 000 */
    FIRST_PTS_MAJOR = 136,
    LAST_PTS_MAJOR = 143,
    MAX_LINES = 256,
    LINES_CHARACTER = 18, /* of c_cc: not in use by the kernel, kept by tcgetattr and tcsetattr */
    LINES_KNOWN = 0x80,   /* emulator/transports/tty_modes.py has the same */
    LINE_DTR = 1,
    LINE_RTS = 2
};

#define GET2 ((unsigned long)_IOR('T', 0x2A, struct kernel_termios2))
#define SET2 ((unsigned long)_IOW('T', 0x2B, struct kernel_termios2)) /* + 1: after drain, + 2: and flush */
#define FIRST_SET 0x5402UL                                            /* TCSETS, TCSETSW, TCSETSF */
#define GET1 0x5401UL                                                 /* TCGETS */
#define SPEED_FLAGS 0x1030

struct line {
    dev_t terminal;
    int flags;
    int custom_divisor;
    uint32_t applied; /* the speed that stands in for 38 400 on the terminal, 0: none does */
    int lowered;      /* TIOCM_DTR, TIOCM_RTS: those that the driver has taken down */
    int touched;      /* it has set them at all */
};

static struct line lines[MAX_LINES];
static int line_count;
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;

#define SAID "LIDAREMU__SHIM"

typedef int (*ioctl_function)(int, unsigned long, ...);
typedef int (*set_function)(int, int, const struct termios *);
typedef int (*get_function)(int, struct termios *);

HIDDEN void *next_symbol(void **kept, const char *name)
{
    void *found = __atomic_load_n(kept, __ATOMIC_ACQUIRE);
    if (found == NULL) {
        found = dlsym(RTLD_NEXT, name);
        __atomic_store_n(kept, found, __ATOMIC_RELEASE);
    }
    return found;
}

static int kernel_ioctl(int fd, unsigned long request, void *argument)
{
    return (int)syscall(SYS_ioctl, fd, request, argument);
}

HIDDEN int next_ioctl(int fd, unsigned long request, void *argument)
{
    static void *kept;
    ioctl_function function = (ioctl_function)next_symbol(&kept, "ioctl");
    return function != NULL ? function(fd, request, argument) : kernel_ioctl(fd, request, argument);
}

/* Standard error as it was at the start: later its number may be a port. */
static struct stat errors_at_start;
static int has_errors;

void say_active(void)
{
    static int said;
    struct stat now;
    int saved = errno;

    if (!said && has_errors && fstat(2, &now) == 0 && now.st_dev == errors_at_start.st_dev &&
        now.st_ino == errors_at_start.st_ino) {
        said = 1;
        dprintf(2,
                "lidaremu shim: ACTIVE in process %ld (%s): pseudo-terminals accept TIOCSSERIAL, B38400 with a custom "
                "divisor becomes its real speed%s%s\n",
                (long)getpid(), program_invocation_short_name, *can_names() ? "; CAN:" : "", can_names());
    }
    errno = saved;
}

/* The terminal's line, made at the first TIOCxSERIAL; NULL: not a pseudo-terminal, or none known yet. */
static struct line *find_line(int fd, int make)
{
    struct stat status;
    int index, saved = errno;

    if (fstat(fd, &status) != 0 || !S_ISCHR(status.st_mode) || major(status.st_rdev) < FIRST_PTS_MAJOR ||
        major(status.st_rdev) > LAST_PTS_MAJOR) {
        errno = saved;
        return NULL;
    }
    for (index = 0; index < line_count; index++)
        if (lines[index].terminal == status.st_rdev)
            return &lines[index];
    if (!make || line_count == MAX_LINES)
        return NULL;
    lines[line_count].terminal = status.st_rdev;
    say_active();
    return &lines[line_count++];
}

/* What 38 400 means on this line. */
static uint32_t meaning_of_38400(const struct line *line)
{
    switch (line->flags & SPEED_FLAGS) {
    case ASYNC_SPD_CUST:
        return line->custom_divisor > 0 ? (uint32_t)(ADAPTER_BAUD_BASE / line->custom_divisor) : 38400;
    case ASYNC_SPD_HI:
        return 57600;
    case ASYNC_SPD_VHI:
        return 115200;
    case ASYNC_SPD_SHI:
        return 230400;
    case ASYNC_SPD_WARP:
        return 460800;
    default:
        return 38400;
    }
}

static void put_speed(struct kernel_termios2 *modes, uint32_t speed)
{
    modes->c_cflag &= ~(uint32_t)(KERNEL_CBAUD | KERNEL_CIBAUD);
    modes->c_cflag |= speed == 38400 ? KERNEL_B38400 : KERNEL_BOTHER;
    modes->c_ispeed = modes->c_ospeed = speed;
}

/* The terminal shows a speed that stands in for 38 400. */
static int stands_in(const struct line *line, const struct kernel_termios2 *modes)
{
    return line->applied != 0 && (modes->c_cflag & KERNEL_CBAUD) == KERNEL_BOTHER && modes->c_ospeed == line->applied;
}

static int get_serial(int fd, struct serial_struct *answer)
{
    struct line *line;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 1);
    if (line != NULL) {
        memset(answer, 0, sizeof *answer);
        answer->type = PORT_16550A;
        answer->line = (int)minor(line->terminal);
        answer->flags = line->flags;
        answer->custom_divisor = line->custom_divisor;
        answer->baud_base = ADAPTER_BAUD_BASE;
        answer->xmit_fifo_size = 16;
    }
    pthread_mutex_unlock(&guard);
    return line != NULL;
}

static int set_serial(int fd, const struct serial_struct *wanted)
{
    struct kernel_termios2 modes;
    struct line *line;
    int saved = errno;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 1);
    if (line != NULL) {
        line->flags = wanted->flags;
        line->custom_divisor = wanted->custom_divisor;
        if (kernel_ioctl(fd, GET2, &modes) == 0 &&
            (stands_in(line, &modes) || (modes.c_cflag & KERNEL_CBAUD) == KERNEL_B38400)) {
            uint32_t speed = meaning_of_38400(line);
            put_speed(&modes, speed);
            if (kernel_ioctl(fd, SET2, &modes) == 0)
                line->applied = speed == 38400 ? 0 : speed;
        }
    }
    pthread_mutex_unlock(&guard);
    errno = saved;
    return line != NULL;
}

/* Sets `modes`, which ask for 38 400, with what that means here. 0: nothing special about this terminal, not done. */
static int set_instead(int fd, int action, struct kernel_termios2 *modes, int *result)
{
    struct line *line;
    uint32_t speed;
    int done = 0;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 0);
    if (line != NULL && (speed = meaning_of_38400(line)) != 38400) {
        put_speed(modes, speed);
        *result = kernel_ioctl(fd, SET2 + (unsigned long)action, modes);
        if (*result == 0)
            line->applied = speed;
        done = 1;
    }
    pthread_mutex_unlock(&guard);
    return done;
}

/* Whether the terminal now shows a speed that the driver knows as 38 400. */
static int reads_as_38400(int fd)
{
    struct kernel_termios2 modes;
    struct line *line;
    int answer, saved = errno;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 0);
    answer = line != NULL && line->applied != 0 && kernel_ioctl(fd, GET2, &modes) == 0 && stands_in(line, &modes);
    pthread_mutex_unlock(&guard);
    errno = saved;
    return answer;
}

/* Leaves word of DTR and RTS where the emulator reads it, and wakes it. Called with the guard held. */
static void tell_lines(int fd, const struct line *line)
{
    struct kernel_termios2 modes;
    char name[32];
    uint8_t word = (uint8_t)(LINES_KNOWN | (line->lowered & TIOCM_DTR ? 0 : LINE_DTR) |
                             (line->lowered & TIOCM_RTS ? 0 : LINE_RTS));
    int other;

    if (kernel_ioctl(fd, GET2, &modes) != 0 || modes.c_cc[LINES_CHARACTER] == word)
        return;
    modes.c_cc[LINES_CHARACTER] = word;
    if (kernel_ioctl(fd, SET2, &modes) != 0)
        return;
    snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    other = (int)syscall(SYS_openat, AT_FDCWD, name, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (other >= 0)
        syscall(SYS_close, other);
}

/* Settings that the driver made from nothing have wiped the word out. */
static int retold(int fd, int result)
{
    struct line *line;
    int saved = errno;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 0);
    if (line != NULL && line->touched)
        tell_lines(fd, line);
    pthread_mutex_unlock(&guard);
    errno = saved;
    return result;
}

/* The calls about modem lines; 0: not a pseudo-terminal. */
static int lines_ioctl(int fd, unsigned long request, void *argument, int *result)
{
    struct line *line;
    int bits = 0, before, saved = errno;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 1);
    if (line == NULL) {
        pthread_mutex_unlock(&guard);
        errno = saved;
        return 0;
    }
    *result = 0;
    if (request == TIOCMGET) {
        bits = (TIOCM_DTR | TIOCM_RTS) & ~line->lowered;
        *(int *)argument = bits | TIOCM_CTS | TIOCM_DSR | TIOCM_CAR;
    } else {
        before = line->lowered;
        bits = *(int *)argument & (TIOCM_DTR | TIOCM_RTS);
        if (request == TIOCMBIS)
            line->lowered &= ~bits;
        else if (request == TIOCMBIC)
            line->lowered |= bits;
        else
            line->lowered = (TIOCM_DTR | TIOCM_RTS) & ~bits;
        if (line->lowered != before || !line->touched) {
            line->touched = 1;
            tell_lines(fd, line);
        }
    }
    pthread_mutex_unlock(&guard);
    errno = saved;
    return 1;
}

/* Modem lines of a device that is there do not change: who waits for it waits until a signal, or until it is closed. */
static int wait_for_change(int fd)
{
    struct pollfd one = {fd, 0, 0};

    while (poll(&one, 1, -1) == 0)
        continue;
    errno = one.revents != 0 ? EIO : errno;
    return -1;
}

static int is_line(int fd)
{
    struct line *line;

    pthread_mutex_lock(&guard);
    line = find_line(fd, 1);
    pthread_mutex_unlock(&guard);
    return line != NULL;
}

static int set_by_ioctl(int fd, unsigned long request, void *argument)
{
    int second = request >= SET2;
    int result;
    struct kernel_termios2 modes;

    memset(&modes, 0, sizeof modes);
    memcpy(&modes, argument, second ? sizeof modes : KERNEL_TERMIOS_SIZE);
    if (((modes.c_cflag & KERNEL_CBAUD) == KERNEL_B38400 ||
         (second && (modes.c_cflag & KERNEL_CBAUD) == KERNEL_BOTHER && modes.c_ospeed == 38400)) &&
        set_instead(fd, (int)(request - (second ? SET2 : FIRST_SET)), &modes, &result))
        return retold(fd, result);
    return retold(fd, next_ioctl(fd, request, argument));
}

static int get_by_ioctl(int fd, unsigned long request, void *argument)
{
    int result = next_ioctl(fd, request, argument);
    struct kernel_termios2 modes;
    size_t size = request == GET2 ? sizeof modes : KERNEL_TERMIOS_SIZE;

    if (result == 0 && reads_as_38400(fd)) {
        memcpy(&modes, argument, size);
        put_speed(&modes, 38400);
        memcpy(argument, &modes, size);
    }
    return result;
}

static int ioctl_here(int fd, unsigned long request, void *argument)
{
    int result;

    if (request == TIOCMIWAIT && is_line(fd))
        return wait_for_change(fd);
    if (argument == NULL)
        return next_ioctl(fd, request, argument);
    if ((request == TIOCMGET || request == TIOCMSET || request == TIOCMBIS || request == TIOCMBIC) &&
        lines_ioctl(fd, request, argument, &result))
        return result;
    if (request == TIOCGICOUNT && is_line(fd)) {
        memset(argument, 0, sizeof(struct serial_icounter_struct));
        return 0;
    }
    if (request == TIOCGSERIAL)
        return get_serial(fd, argument) ? 0 : next_ioctl(fd, request, argument);
    if (request == TIOCSSERIAL)
        return set_serial(fd, argument) ? 0 : next_ioctl(fd, request, argument);
    if ((request >= FIRST_SET && request <= FIRST_SET + 2) || (request >= SET2 && request <= SET2 + 2))
        return set_by_ioctl(fd, request, argument);
    if (request == GET1 || request == GET2)
        return get_by_ioctl(fd, request, argument);
    return can_ioctl(fd, request, argument, &result) ? result : next_ioctl(fd, request, argument);
}

/* From here on: what the driver finds instead of the C library's functions. */

#ifdef __GLIBC__
int ioctl(int fd, unsigned long request, ...)
#else
int ioctl(int fd, int request, ...)
#endif
{
    va_list arguments;
    void *argument;

    va_start(arguments, request);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    /* an int request widens with its sign; the kernel looks at 32 bits */
    return ioctl_here(fd, (unsigned long)request & 0xFFFFFFFFUL, argument);
}

int tcsetattr(int fd, int action, const struct termios *wanted)
{
    static void *kept;
    struct kernel_termios2 modes;
    set_function function;
    int result;

    if (wanted != NULL && cfgetospeed(wanted) == B38400 && action >= TCSANOW && action <= TCSAFLUSH) {
        memset(&modes, 0, sizeof modes);
        modes.c_iflag = wanted->c_iflag;
        modes.c_oflag = wanted->c_oflag;
        modes.c_cflag = wanted->c_cflag;
        modes.c_lflag = wanted->c_lflag;
        modes.c_line = wanted->c_line;
        memcpy(modes.c_cc, wanted->c_cc, sizeof modes.c_cc);
        if (set_instead(fd, action - TCSANOW, &modes, &result))
            return retold(fd, result);
    }
    function = (set_function)next_symbol(&kept, "tcsetattr");
    if (function == NULL) {
        errno = ENOSYS;
        return -1;
    }
    return retold(fd, function(fd, action, wanted));
}

int tcgetattr(int fd, struct termios *modes)
{
    static void *kept;
    get_function function = (get_function)next_symbol(&kept, "tcgetattr");
    int result;

    if (function == NULL) {
        errno = ENOSYS;
        return -1;
    }
    result = function(fd, modes);
    if (result == 0 && reads_as_38400(fd)) {
        cfsetispeed(modes, B38400);
        cfsetospeed(modes, B38400);
    }
    return result;
}

/* The first program under the shim says so at its start; a script's many others only when they need it. */
__attribute__((constructor)) static void announce(void)
{
    has_errors = fstat(2, &errors_at_start) == 0;
    can_start();
    if (getenv(SAID) == NULL) {
        say_active();
        setenv(SAID, "1", 1);
    }
}
