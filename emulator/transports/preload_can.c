/*
 * Preloaded into a driver under test: SocketCAN's raw sockets without a CAN kernel module.
 *
 * LIDAREMU__CAN names the emulator's socket and the interfaces behind it ("@name;can0=1000001"). A socket(AF_CAN, SOCK_RAW,
 * CAN_RAW) becomes a Unix seqpacket socket to the emulator: one packet a frame, so select, poll, epoll, fork, dup and
 * non-blocking use are the kernel's own. A packet is a struct can_frame and, behind it, what the kernel would know of
 * it: interface, time, whose it is. Filters and the other options of a socket live in the emulator.
 *
 * An interface of that name which the kernel has is left to the kernel. Not carried: CAN FD frames (the interface is a
 * classical one: CAN_RAW_FD_FRAMES may be set, as on one, frames of 72 bytes are EMSGSIZE or EINVAL), remote frames
 * (EOPNOTSUPP), CAN_BCM, CAN_ISOTP and CAN_J1939 (EPROTONOSUPPORT), CAN_RAW_XL_FRAMES (ENOPROTOOPT). Not covered:
 * statically linked drivers, sockets handed over an exec or to another process, netlink and /sys/class/net.
 */
#define _GNU_SOURCE
#include "preload_shim.h"
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/net_tstamp.h>
#include <net/if.h>
#include <net/if_arp.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#ifndef CAN_RAW_JOIN_FILTERS
#define CAN_RAW_JOIN_FILTERS 6
#endif
#ifndef SO_RXQ_OVFL
#define SO_RXQ_OVFL 40
#endif

enum {
    MAX_FDS = 65536,
    MAX_INTERFACES = 16,
    MAX_FILTERS = 4096, /* the kernel's 512 since 4.10; older ones took more, and Apollo asks for 2048 */
    NO_INTERFACE = -1,  /* connected, but nothing is received */
    ADDRESS_BYTES = 8,  /* of a sockaddr_can, as the kernel counts it: family and interface */
    PATIENCE_MS = 10000,
    GET_STAMP = 0x8906, /* SIOCGSTAMP, SIOCGSTAMPNS */
    GET_STAMP_NS = 0x8907
};

/* What passes between shim and emulator; emulator/transports/can_sockets.py has the same. */
enum { MAGIC = 0x4E41434C, LOOPBACK = 1, RECEIVE_OWN = 2, JOIN_FILTERS = 4, FROM_HERE = 1, OWN = 2 };

struct request {
    uint32_t magic, version;
    uint64_t number; /* 0: this connection becomes a new socket; else the one whose options change */
    int32_t interface;
    uint32_t flags, error_mask, filters;
};

struct answer {
    uint32_t magic;
    int32_t error;
    uint64_t number;
};

struct packet {
    struct can_frame frame;
    int32_t interface;
    uint32_t flags;
    int64_t time_ns;
    uint32_t drops, reserved;
};

struct can_socket {
    dev_t device; /* of the socket behind the descriptor: a number that was closed behind our back is somebody else's */
    ino_t inode;
    int references, of_kernel, connected, bound;
    uint64_t number;
    int32_t interface;
    uint32_t flags, error_mask, filter_count;
    struct can_filter *filters;
    int stamp, stamping, count_drops, fd_frames, error_set;
    int64_t last_stamp_ns;
};

static struct can_socket *sockets[MAX_FDS];
static struct {
    char name[IFNAMSIZ];
    int index;
} interfaces[MAX_INTERFACES];
static int interface_count;
static char names[MAX_INTERFACES * (IFNAMSIZ + 1) + 1];
static struct sockaddr_un emulator;
static socklen_t emulator_length;
static pid_t owner; /* a child of vfork shares our memory, not our descriptors */
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;

/* The function of the C library that `name` is; `call` it with the type that stands there. */
#define NEXT(type, name) \
    static void *kept_##name; \
    __typeof__(type) next_##name = (__typeof__(type))next_symbol(&kept_##name, #name)

/* A function that the driver finds instead of the C library's. */
#define INSTEAD(type, ours, name, ...) \
    __attribute__((visibility("default"))) type ours(__VA_ARGS__) __asm__(name); \
    type ours(__VA_ARGS__)

static int fail(int error)
{
    errno = error;
    return -1;
}

/* ------------------------------------------------------------------ interfaces */

static void before_fork(void) { pthread_mutex_lock(&guard); }
static void after_fork(void) { pthread_mutex_unlock(&guard); }
static void in_child(void)
{
    owner = getpid();
    pthread_mutex_unlock(&guard);
}

HIDDEN void can_start(void)
{
    const char *text = getenv("LIDAREMU__CAN"), *end;

    owner = getpid();
    if (text == NULL || text[0] != '@' || (end = strchr(text, ';')) == NULL ||
        (size_t)(end - text) >= sizeof emulator.sun_path)
        return;
    emulator.sun_family = AF_UNIX;
    memcpy(emulator.sun_path + 1, text + 1, (size_t)(end - text) - 1); /* the abstract namespace: a zero stands first */
    emulator_length = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + (size_t)(end - text));
    while (end != NULL && *end == ';' && interface_count < MAX_INTERFACES) {
        const char *name = end + 1, *equals = strchr(name, '=');
        size_t length = equals == NULL ? 0 : (size_t)(equals - name);
        if (length == 0 || length >= IFNAMSIZ)
            break;
        memcpy(interfaces[interface_count].name, name, length);
        interfaces[interface_count].index = atoi(equals + 1);
        strcat(names, " ");
        strcat(names, interfaces[interface_count].name);
        interface_count++;
        end = strchr(equals, ';');
    }
    pthread_atfork(before_fork, after_fork, in_child);
}

HIDDEN const char *can_names(void) { return names; }

static int index_of(const char *name)
{
    int k;
    for (k = 0; k < interface_count; k++)
        if (strncmp(interfaces[k].name, name, IFNAMSIZ) == 0)
            return interfaces[k].index;
    return 0;
}

static const char *name_of(int index)
{
    int k;
    for (k = 0; k < interface_count; k++)
        if (interfaces[k].index == index)
            return interfaces[k].name;
    return NULL;
}

/* ------------------------------------------------------------------ which descriptors are ours */

static int identify(int fd, dev_t *device, ino_t *inode)
{
    struct stat status;
    if (fstat(fd, &status) != 0)
        return -1;
    *device = status.st_dev;
    *inode = status.st_ino;
    return 0;
}

/* The CAN socket behind a descriptor, NULL: it is none. */
static struct can_socket *find(int fd)
{
    struct can_socket *found;
    dev_t device;
    ino_t inode;
    int saved = errno;

    if (fd < 0 || fd >= MAX_FDS || (found = __atomic_load_n(&sockets[fd], __ATOMIC_ACQUIRE)) == NULL)
        return NULL;
    if (identify(fd, &device, &inode) != 0 || device != found->device || inode != found->inode)
        found = NULL;
    errno = saved;
    return found;
}

/* The same, unless the kernel carries it. */
static struct can_socket *find_carried(int fd)
{
    struct can_socket *found = find(fd);
    return found != NULL && !found->of_kernel ? found : NULL;
}

static void forget(int fd)
{
    struct can_socket *old = fd >= 0 && fd < MAX_FDS ? sockets[fd] : NULL;
    if (old == NULL)
        return;
    __atomic_store_n(&sockets[fd], NULL, __ATOMIC_RELEASE);
    if (--old->references == 0) {
        free(old->filters);
        free(old);
    }
}

static void keep(int fd, struct can_socket *socket_)
{
    if (fd < 0 || fd >= MAX_FDS)
        return;
    forget(fd);
    socket_->references++;
    __atomic_store_n(&sockets[fd], socket_, __ATOMIC_RELEASE);
}

/* A descriptor was made from another one. */
static int copied(int from, int to)
{
    struct can_socket *original;
    if (to < 0 || getpid() != owner || from == to)
        return to;
    original = find(from);
    pthread_mutex_lock(&guard);
    if (original != NULL)
        keep(to, original);
    else
        forget(to);
    pthread_mutex_unlock(&guard);
    return to;
}

/* ------------------------------------------------------------------ to and from the emulator */

static ssize_t send_plain(int fd, const struct msghdr *message, int flags)
{
    NEXT(ssize_t(*)(int, const struct msghdr *, int), sendmsg);
    return next_sendmsg(fd, message, flags | MSG_NOSIGNAL);
}

static ssize_t receive_plain(int fd, struct msghdr *message, int flags)
{
    NEXT(ssize_t(*)(int, struct msghdr *, int), recvmsg);
    return next_recvmsg(fd, message, flags);
}

static int close_plain(int fd)
{
    NEXT(int (*)(int), close);
    return next_close(fd);
}

static int new_socket(int flags)
{
    NEXT(int (*)(int, int, int), socket);
    return next_socket(AF_UNIX, SOCK_SEQPACKET | flags, 0);
}

static int64_t monotonic_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Connects whether or not the descriptor blocks; a full queue of the emulator is waited for. */
static int connect_emulator(int fd)
{
    NEXT(int (*)(int, const struct sockaddr *, socklen_t), connect);
    int64_t end_ms = monotonic_ms() + PATIENCE_MS;

    while (next_connect(fd, (const struct sockaddr *)&emulator, emulator_length) != 0) {
        if (errno != EAGAIN && errno != EINTR)
            return fail(ENODEV); /* the emulator has gone, and the interface with it */
        if (monotonic_ms() > end_ms)
            return fail(ETIMEDOUT);
        poll(NULL, 0, 5);
    }
    return 0;
}

/* Sends the socket's options and waits until they hold. */
static int tell(int fd, struct can_socket *socket_, int32_t interface, uint64_t number, uint64_t *given)
{
    struct request request = {MAGIC, 1, number, interface, socket_->flags, socket_->error_mask, socket_->filter_count};
    struct iovec parts[2] = {{&request, sizeof request},
                             {socket_->filters, socket_->filter_count * sizeof(struct can_filter)}};
    struct answer answer;
    struct iovec whole = {&answer, sizeof answer};
    struct msghdr message = {0};
    struct pollfd wait = {fd, POLLOUT, 0};
    int64_t end_ms = monotonic_ms() + PATIENCE_MS, left;
    ssize_t count;

    message.msg_iov = parts;
    message.msg_iovlen = socket_->filter_count != 0 ? 2 : 1;
    while (send_plain(fd, &message, 0) < 0) {
        if (errno != EAGAIN && errno != EINTR)
            return fail(ENODEV);
        poll(&wait, 1, 100);
        if (monotonic_ms() > end_ms)
            return fail(ETIMEDOUT);
    }
    wait.events = POLLIN;
    message.msg_iov = &whole;
    message.msg_iovlen = 1;
    for (;;) {
        left = end_ms - monotonic_ms();
        if (left <= 0)
            return fail(ETIMEDOUT);
        if (poll(&wait, 1, (int)left) <= 0)
            continue;
        count = receive_plain(fd, &message, MSG_DONTWAIT);
        if (count == (ssize_t)sizeof answer && answer.magic == MAGIC)
            break;
        if (count >= 0 || (errno != EAGAIN && errno != EINTR))
            return fail(ENODEV);
    }
    if (answer.error != 0)
        return fail(answer.error);
    if (given != NULL)
        *given = answer.number;
    return 0;
}

/* Options of a socket that is connected already: over a connection of their own, frames may wait on the first. */
static int tell_change(struct can_socket *socket_, int32_t interface)
{
    int fd, result;

    if ((fd = new_socket(SOCK_CLOEXEC)) < 0)
        return -1;
    result = connect_emulator(fd) == 0 ? tell(fd, socket_, interface, socket_->number, NULL) : -1;
    if (result != 0) {
        int saved = errno;
        close_plain(fd);
        return fail(saved);
    }
    return close_plain(fd);
}

/* Makes the socket one of the emulator's; the kernel's own, if there was one, is replaced under its number. */
static int attach(int fd, struct can_socket *socket_, int32_t interface)
{
    int other, result;

    if (socket_->connected)
        return tell_change(socket_, interface);
    if (!socket_->of_kernel) {
        if (connect_emulator(fd) != 0 || tell(fd, socket_, interface, 0, &socket_->number) != 0)
            return -1;
    } else {
        NEXT(int (*)(int, int, int), dup3);
        struct timeval limit;
        socklen_t size = sizeof limit;
        int modes = fcntl(fd, F_GETFL), flags = fcntl(fd, F_GETFD);
        if ((other = new_socket(SOCK_CLOEXEC)) < 0)
            return -1;
        if (getsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, &size) == 0)
            setsockopt(other, SOL_SOCKET, SO_RCVTIMEO, &limit, size);
        if (modes >= 0 && (modes & O_NONBLOCK))
            fcntl(other, F_SETFL, O_NONBLOCK);
        result = connect_emulator(other) == 0 ? tell(other, socket_, interface, 0, &socket_->number) : -1;
        if (result == 0 && next_dup3(other, fd, flags >= 0 && (flags & FD_CLOEXEC) ? O_CLOEXEC : 0) < 0)
            result = -1;
        if (result == 0)
            result = identify(fd, &socket_->device, &socket_->inode);
        int saved = errno;
        close_plain(other);
        errno = saved;
        if (result != 0)
            return -1;
        socket_->of_kernel = 0;
    }
    socket_->connected = 1;
    return 0;
}

/* ------------------------------------------------------------------ frames */

static size_t scatter(const struct iovec *parts, size_t count, const void *from, size_t size)
{
    size_t done = 0, k, now;
    for (k = 0; k < count && done < size; k++) {
        now = parts[k].iov_len < size - done ? parts[k].iov_len : size - done;
        if (now != 0)
            memcpy(parts[k].iov_base, (const char *)from + done, now);
        done += now;
    }
    return done;
}

static void put_control(struct msghdr *message, size_t *used, int type, const void *value, size_t size)
{
    struct cmsghdr header;
    char *place = (char *)message->msg_control + *used;

    if (message->msg_control == NULL || message->msg_controllen < *used + CMSG_LEN(size)) {
        message->msg_flags |= MSG_CTRUNC;
        return;
    }
    memset(&header, 0, sizeof header);
    header.cmsg_len = CMSG_LEN(size);
    header.cmsg_level = SOL_SOCKET;
    header.cmsg_type = type;
    memcpy(place, &header, sizeof header);
    memcpy(place + CMSG_LEN(0), value, size);
    *used += CMSG_SPACE(size) < message->msg_controllen - *used ? CMSG_SPACE(size) : CMSG_LEN(size);
}

static void fill_address(void *to, socklen_t *length, int32_t interface)
{
    struct sockaddr_can address;
    if (to == NULL || length == NULL)
        return;
    memset(&address, 0, sizeof address);
    address.can_family = AF_CAN;
    address.can_ifindex = interface;
    memcpy(to, &address, *length < sizeof address ? *length : sizeof address);
    *length = ADDRESS_BYTES;
}

/* As the kernel: an unbound socket hears nothing. */
static int wait_unbound(int fd, int flags)
{
    struct timeval limit = {0, 0};
    socklen_t size = sizeof limit;
    int modes = fcntl(fd, F_GETFL);

    if ((flags & MSG_DONTWAIT) || (modes >= 0 && (modes & O_NONBLOCK)))
        return fail(EAGAIN);
    getsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, &size);
    if (limit.tv_sec == 0 && limit.tv_usec == 0)
        return poll(NULL, 0, -1);
    return poll(NULL, 0, (int)(limit.tv_sec * 1000 + limit.tv_usec / 1000)) < 0 ? -1 : fail(EAGAIN);
}

static ssize_t take(int fd, struct can_socket *socket_, struct msghdr *wanted, int flags)
{
    struct packet packet;
    struct iovec whole = {&packet, sizeof packet};
    struct msghdr message = {0};
    size_t given, used = 0;
    ssize_t count;

    if (!socket_->connected)
        return wait_unbound(fd, flags);
    message.msg_iov = &whole;
    message.msg_iovlen = 1;
    count = receive_plain(fd, &message, flags & (MSG_PEEK | MSG_DONTWAIT));
    if (count < 0)
        return errno == ECONNRESET || errno == ENOTCONN ? fail(ENETDOWN) : -1;
    if (count != (ssize_t)sizeof packet)
        return fail(ENETDOWN); /* the emulator has gone */
    wanted->msg_flags = 0;
    given = scatter(wanted->msg_iov, wanted->msg_iovlen, &packet.frame, sizeof packet.frame);
    if (given < sizeof packet.frame)
        wanted->msg_flags |= MSG_TRUNC;
    if (packet.flags & FROM_HERE)
        wanted->msg_flags |= MSG_DONTROUTE;
    if (packet.flags & OWN)
        wanted->msg_flags |= MSG_CONFIRM;
    if (wanted->msg_name != NULL)
        fill_address(wanted->msg_name, &wanted->msg_namelen, packet.interface);
    __atomic_store_n(&socket_->last_stamp_ns, packet.time_ns, __ATOMIC_RELAXED);
    if (wanted->msg_control != NULL || wanted->msg_controllen != 0) {
        struct timespec time = {(time_t)(packet.time_ns / 1000000000), (long)(packet.time_ns % 1000000000)};
        if (socket_->stamp == SO_TIMESTAMP) {
            struct timeval coarse = {time.tv_sec, (suseconds_t)(time.tv_nsec / 1000)};
            put_control(wanted, &used, SO_TIMESTAMP, &coarse, sizeof coarse);
        } else if (socket_->stamp == SO_TIMESTAMPNS) {
            put_control(wanted, &used, SO_TIMESTAMPNS, &time, sizeof time);
        }
        if (socket_->stamping & SOF_TIMESTAMPING_SOFTWARE) {
            struct timespec times[3];
            memset(times, 0, sizeof times);
            times[0] = time;
            put_control(wanted, &used, SO_TIMESTAMPING, times, sizeof times);
        }
        if (socket_->count_drops)
            put_control(wanted, &used, SO_RXQ_OVFL, &packet.drops, sizeof packet.drops);
    }
    wanted->msg_controllen = used;
    return (ssize_t)given;
}

static ssize_t take_into(int fd, struct can_socket *socket_, void *buffer, size_t size, int flags)
{
    struct iovec part = {buffer, size};
    struct msghdr message = {0};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    return take(fd, socket_, &message, flags);
}

static ssize_t put(int fd, struct can_socket *socket_, const struct msghdr *wanted, int flags)
{
    struct packet packet;
    struct iovec whole = {&packet, sizeof packet};
    struct msghdr message = {0};
    size_t size = 0, done = 0, k;
    int32_t interface = socket_->bound ? socket_->interface : 0;

    memset(&packet, 0, sizeof packet);
    if (wanted->msg_name != NULL && wanted->msg_namelen != 0) {
        struct sockaddr_can address;
        if (wanted->msg_namelen < ADDRESS_BYTES)
            return fail(EINVAL);
        memset(&address, 0, sizeof address);
        memcpy(&address, wanted->msg_name, ADDRESS_BYTES);
        if (address.can_family != AF_CAN)
            return fail(EINVAL);
        interface = address.can_ifindex;
    }
    for (k = 0; k < wanted->msg_iovlen; k++)
        size += wanted->msg_iov[k].iov_len;
    if (size == CANFD_MTU && socket_->fd_frames)
        return fail(EMSGSIZE); /* a classical interface has no room for it */
    if (size != CAN_MTU)
        return fail(EINVAL);
    if (name_of(interface) == NULL)
        return fail(ENXIO);
    for (k = 0; k < wanted->msg_iovlen; k++) {
        memcpy((char *)&packet.frame + done, wanted->msg_iov[k].iov_base, wanted->msg_iov[k].iov_len);
        done += wanted->msg_iov[k].iov_len;
    }
    if (packet.frame.can_dlc > CAN_MAX_DLEN)
        return fail(EINVAL);
    if (packet.frame.can_id & CAN_RTR_FLAG)
        return fail(EOPNOTSUPP);
    if (packet.frame.can_id & CAN_ERR_FLAG) /* no controller sends one */
        return fail(EOPNOTSUPP);
    if (!socket_->connected && attach(fd, socket_, NO_INTERFACE) != 0)
        return -1;
    packet.interface = interface;
    message.msg_iov = &whole;
    message.msg_iovlen = 1;
    if (send_plain(fd, &message, flags & MSG_DONTWAIT) < 0)
        return errno == EPIPE || errno == ECONNRESET || errno == ENOTCONN ? fail(ENETDOWN) : -1;
    return CAN_MTU;
}

/* ------------------------------------------------------------------ options */

static int set_filters(struct can_socket *socket_, const void *value, socklen_t size)
{
    struct can_filter *copy = NULL;
    uint32_t count = (uint32_t)(size / sizeof(struct can_filter));

    if (size % sizeof(struct can_filter) != 0 || count > MAX_FILTERS)
        return fail(EINVAL);
    if (count != 0) {
        if (value == NULL)
            return fail(EFAULT);
        if ((copy = malloc(size)) == NULL)
            return fail(ENOMEM);
        memcpy(copy, value, size);
    }
    pthread_mutex_lock(&guard);
    struct can_filter *old = socket_->filters;
    socket_->filters = copy;
    socket_->filter_count = count;
    pthread_mutex_unlock(&guard);
    free(old);
    return 0;
}

static int set_flag(struct can_socket *socket_, uint32_t flag, const void *value, socklen_t size)
{
    int on;
    if (size != sizeof on)
        return fail(EINVAL);
    memcpy(&on, value, sizeof on);
    socket_->flags = on ? socket_->flags | flag : socket_->flags & ~flag;
    return 0;
}

static int set_raw_option(struct can_socket *socket_, int name, const void *value, socklen_t size)
{
    int result, on;

    if (value == NULL && name != CAN_RAW_FILTER)
        return fail(EFAULT);
    switch (name) {
    case CAN_RAW_FILTER:
        result = set_filters(socket_, value, size);
        break;
    case CAN_RAW_ERR_FILTER:
        if (size != sizeof socket_->error_mask)
            return fail(EINVAL);
        memcpy(&socket_->error_mask, value, size);
        socket_->error_mask &= CAN_ERR_MASK;
        result = 0;
        break;
    case CAN_RAW_LOOPBACK:
        result = set_flag(socket_, LOOPBACK, value, size);
        break;
    case CAN_RAW_RECV_OWN_MSGS:
        result = set_flag(socket_, RECEIVE_OWN, value, size);
        break;
    case CAN_RAW_JOIN_FILTERS:
        result = set_flag(socket_, JOIN_FILTERS, value, size);
        break;
    case CAN_RAW_FD_FRAMES:
        if (size != sizeof on)
            return fail(EINVAL);
        memcpy(&on, value, sizeof on);
        socket_->fd_frames = on != 0;
        return 0;
    default:
        return fail(ENOPROTOOPT);
    }
    if (result == 0 && socket_->connected)
        return tell_change(socket_, socket_->bound ? socket_->interface : NO_INTERFACE);
    return result;
}

/* Options of SOL_SOCKET that the kernel would keep for a CAN socket but has no use for on ours; 0: not one of them. */
static int set_socket_option(struct can_socket *socket_, int name, const void *value, socklen_t size)
{
    int on = 0;

    if (value == NULL || size < sizeof on)
        return 0;
    memcpy(&on, value, sizeof on);
    if (name == SO_TIMESTAMP || name == SO_TIMESTAMPNS)
        socket_->stamp = on ? name : 0;
    else if (name == SO_TIMESTAMPING)
        socket_->stamping = on;
    else if (name == SO_RXQ_OVFL)
        socket_->count_drops = on != 0;
    else
        return 0;
    return 1;
}

static int give_int(void *value, socklen_t *size, int number)
{
    if (*size < sizeof number)
        return fail(EINVAL);
    memcpy(value, &number, sizeof number);
    *size = sizeof number;
    return 0;
}

static int get_raw_option(struct can_socket *socket_, int name, void *value, socklen_t *size)
{
    size_t bytes;

    switch (name) {
    case CAN_RAW_FILTER:
        pthread_mutex_lock(&guard);
        bytes = socket_->filter_count * sizeof(struct can_filter);
        if (*size < bytes) {
            pthread_mutex_unlock(&guard);
            *size = (socklen_t)bytes;
            return fail(ERANGE);
        }
        if (bytes != 0)
            memcpy(value, socket_->filters, bytes);
        pthread_mutex_unlock(&guard);
        *size = (socklen_t)bytes;
        return 0;
    case CAN_RAW_ERR_FILTER:
        return give_int(value, size, (int)socket_->error_mask);
    case CAN_RAW_LOOPBACK:
        return give_int(value, size, (socket_->flags & LOOPBACK) != 0);
    case CAN_RAW_RECV_OWN_MSGS:
        return give_int(value, size, (socket_->flags & RECEIVE_OWN) != 0);
    case CAN_RAW_JOIN_FILTERS:
        return give_int(value, size, (socket_->flags & JOIN_FILTERS) != 0);
    case CAN_RAW_FD_FRAMES:
        return give_int(value, size, socket_->fd_frames);
    default:
        return fail(ENOPROTOOPT);
    }
}

/* ------------------------------------------------------------------ ioctl */

/* The kernel knows no interface of that name or number: perhaps we do. */
static int interface_ioctl(unsigned long request, struct ifreq *about)
{
    int index = request == SIOCGIFNAME ? about->ifr_ifindex : index_of(about->ifr_name);
    const char *name = index == 0 ? NULL : name_of(index);

    if (name == NULL)
        return 0;
    switch (request) {
    case SIOCGIFNAME:
        memset(about->ifr_name, 0, sizeof about->ifr_name);
        memcpy(about->ifr_name, name, strlen(name));
        return 1;
    case SIOCGIFINDEX:
        about->ifr_ifindex = index;
        return 1;
    case SIOCGIFFLAGS:
        about->ifr_flags = IFF_UP | IFF_RUNNING | IFF_NOARP;
        return 1;
    case SIOCGIFMTU:
        about->ifr_mtu = CAN_MTU;
        return 1;
    case SIOCGIFHWADDR:
        memset(&about->ifr_hwaddr, 0, sizeof about->ifr_hwaddr);
        about->ifr_hwaddr.sa_family = ARPHRD_CAN;
        return 1;
    case SIOCGIFTXQLEN:
        about->ifr_qlen = 10;
        return 1;
    default:
        return 0;
    }
}

HIDDEN int can_ioctl(int fd, unsigned long request, void *argument, int *result)
{
    struct can_socket *socket_;
    int64_t stamp_ns;
    int saved = errno;

    if (interface_count == 0 || argument == NULL)
        return 0;
    if (request == SIOCGIFNAME || request == SIOCGIFINDEX || request == SIOCGIFFLAGS || request == SIOCGIFMTU ||
        request == SIOCGIFHWADDR || request == SIOCGIFTXQLEN) {
        *result = next_ioctl(fd, request, argument);
        if (*result < 0 && errno != EBADF && interface_ioctl(request, argument)) {
            *result = 0;
            errno = saved;
        }
        return 1;
    }
    if ((request != GET_STAMP && request != GET_STAMP_NS && request != FIONREAD) || (socket_ = find_carried(fd)) == NULL)
        return 0;
    if (request == FIONREAD) {
        *result = next_ioctl(fd, request, argument);
        if (*result == 0 && *(int *)argument > 0)
            *(int *)argument = CAN_MTU;
        return 1;
    }
    stamp_ns = __atomic_load_n(&socket_->last_stamp_ns, __ATOMIC_RELAXED);
    if (stamp_ns == 0) {
        *result = fail(ENOENT);
    } else if (request == GET_STAMP) {
        struct timeval *coarse = argument;
        coarse->tv_sec = (time_t)(stamp_ns / 1000000000);
        coarse->tv_usec = (suseconds_t)(stamp_ns % 1000000000 / 1000);
        *result = 0;
    } else {
        struct timespec *fine = argument;
        fine->tv_sec = (time_t)(stamp_ns / 1000000000);
        fine->tv_nsec = (long)(stamp_ns % 1000000000);
        *result = 0;
    }
    return 1;
}

/* ------------------------------------------------------------------ instead of the C library's */

INSTEAD(int, can_socket_call, "socket", int domain, int type, int protocol)
{
    NEXT(int (*)(int, int, int), socket);
    struct can_socket *made;
    int fd, kind = type & ~(SOCK_NONBLOCK | SOCK_CLOEXEC), saved = errno;

    fd = next_socket(domain, type, protocol);
    if (domain != AF_CAN || interface_count == 0)
        return fd;
    if (fd < 0 && errno != EAFNOSUPPORT)
        return fd; /* the kernel knows CAN, and that this cannot be */
    if (fd < 0 && protocol != CAN_RAW)
        return fail(protocol < 0 || protocol >= CAN_NPROTO ? EINVAL : EPROTONOSUPPORT);
    if (fd < 0 && kind != SOCK_RAW)
        return fail(EPROTOTYPE);
    if (protocol != CAN_RAW)
        return fd;
    if ((made = calloc(1, sizeof *made)) == NULL || (made->filters = calloc(1, sizeof *made->filters)) == NULL) {
        free(made);
        if (fd >= 0)
            close_plain(fd);
        return fail(ENOMEM);
    }
    made->of_kernel = fd >= 0;
    if (fd < 0)
        fd = new_socket(type & (SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (fd < 0 || fd >= MAX_FDS || identify(fd, &made->device, &made->inode) != 0) {
        saved = fd >= MAX_FDS ? EMFILE : errno;
        if (fd >= 0)
            close_plain(fd);
        free(made->filters);
        free(made);
        return fail(saved);
    }
    made->filter_count = 1; /* mask 0: everything */
    made->flags = LOOPBACK;
    pthread_mutex_lock(&guard);
    keep(fd, made);
    pthread_mutex_unlock(&guard);
    say_active();
    errno = saved;
    return fd;
}

INSTEAD(int, can_bind, "bind", int fd, const struct sockaddr *address, socklen_t length)
{
    NEXT(int (*)(int, const struct sockaddr *, socklen_t), bind);
    struct can_socket *socket_ = find(fd);
    struct sockaddr_can wanted;

    if (socket_ == NULL)
        return next_bind(fd, address, length);
    if (address == NULL || length < ADDRESS_BYTES)
        return fail(EINVAL);
    memset(&wanted, 0, sizeof wanted);
    memcpy(&wanted, address, ADDRESS_BYTES);
    if (wanted.can_family != AF_CAN)
        return fail(EINVAL);
    if (wanted.can_ifindex != 0 && name_of(wanted.can_ifindex) == NULL)
        return socket_->of_kernel ? next_bind(fd, address, length) : fail(ENODEV);
    if (attach(fd, socket_, wanted.can_ifindex) != 0)
        return -1;
    socket_->interface = wanted.can_ifindex;
    socket_->bound = 1;
    return 0;
}

INSTEAD(int, can_connect, "connect", int fd, const struct sockaddr *address, socklen_t length)
{
    NEXT(int (*)(int, const struct sockaddr *, socklen_t), connect);
    return find_carried(fd) != NULL ? fail(EOPNOTSUPP) : next_connect(fd, address, length);
}

INSTEAD(int, can_shutdown, "shutdown", int fd, int how)
{
    NEXT(int (*)(int, int), shutdown);
    return find_carried(fd) != NULL ? fail(EOPNOTSUPP) : next_shutdown(fd, how);
}

INSTEAD(int, can_getsockname, "getsockname", int fd, struct sockaddr *address, socklen_t *length)
{
    NEXT(int (*)(int, struct sockaddr *, socklen_t *), getsockname);
    struct can_socket *socket_ = find_carried(fd);

    if (socket_ == NULL)
        return next_getsockname(fd, address, length);
    fill_address(address, length, socket_->bound ? socket_->interface : 0);
    return 0;
}

INSTEAD(int, can_getpeername, "getpeername", int fd, struct sockaddr *address, socklen_t *length)
{
    NEXT(int (*)(int, struct sockaddr *, socklen_t *), getpeername);
    return find_carried(fd) != NULL ? fail(EOPNOTSUPP) : next_getpeername(fd, address, length);
}

INSTEAD(int, can_setsockopt, "setsockopt", int fd, int level, int name, const void *value, socklen_t size)
{
    NEXT(int (*)(int, int, int, const void *, socklen_t), setsockopt);
    struct can_socket *socket_ = find(fd);
    int result;

    if (socket_ != NULL && level == SOL_CAN_RAW) {
        if (socket_->of_kernel && (result = next_setsockopt(fd, level, name, value, size)) != 0)
            return result;
        return set_raw_option(socket_, name, value, size);
    }
    if (socket_ != NULL && level == SOL_SOCKET && set_socket_option(socket_, name, value, size) && !socket_->of_kernel)
        return 0;
    return next_setsockopt(fd, level, name, value, size);
}

INSTEAD(int, can_getsockopt, "getsockopt", int fd, int level, int name, void *value, socklen_t *size)
{
    NEXT(int (*)(int, int, int, void *, socklen_t *), getsockopt);
    struct can_socket *socket_ = find_carried(fd);

    if (socket_ == NULL)
        return next_getsockopt(fd, level, name, value, size);
    if (value == NULL || size == NULL)
        return fail(EFAULT);
    if (level == SOL_CAN_RAW)
        return get_raw_option(socket_, name, value, size);
    if (level != SOL_SOCKET)
        return next_getsockopt(fd, level, name, value, size);
    switch (name) {
    case SO_DOMAIN:
        return give_int(value, size, AF_CAN);
    case SO_TYPE:
        return give_int(value, size, SOCK_RAW);
    case SO_PROTOCOL:
        return give_int(value, size, CAN_RAW);
    case SO_TIMESTAMP:
    case SO_TIMESTAMPNS:
        return give_int(value, size, socket_->stamp == name);
    case SO_TIMESTAMPING:
        return give_int(value, size, socket_->stamping);
    case SO_RXQ_OVFL:
        return give_int(value, size, socket_->count_drops);
    default:
        return next_getsockopt(fd, level, name, value, size);
    }
}

INSTEAD(ssize_t, can_read, "read", int fd, void *buffer, size_t size)
{
    NEXT(ssize_t(*)(int, void *, size_t), read);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_read(fd, buffer, size) : take_into(fd, socket_, buffer, size, 0);
}

INSTEAD(ssize_t, can_read_checked, "__read_chk", int fd, void *buffer, size_t size, size_t room)
{
    NEXT(ssize_t(*)(int, void *, size_t, size_t), __read_chk);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next___read_chk(fd, buffer, size, room)
                           : take_into(fd, socket_, buffer, size < room ? size : room, 0);
}

INSTEAD(ssize_t, can_readv, "readv", int fd, const struct iovec *parts, int count)
{
    NEXT(ssize_t(*)(int, const struct iovec *, int), readv);
    struct can_socket *socket_ = find_carried(fd);
    struct msghdr message = {0};

    if (socket_ == NULL)
        return next_readv(fd, parts, count);
    if (count < 0)
        return fail(EINVAL);
    message.msg_iov = (struct iovec *)(uintptr_t)parts;
    message.msg_iovlen = (size_t)count;
    return take(fd, socket_, &message, 0);
}

INSTEAD(ssize_t, can_recv, "recv", int fd, void *buffer, size_t size, int flags)
{
    NEXT(ssize_t(*)(int, void *, size_t, int), recv);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_recv(fd, buffer, size, flags) : take_into(fd, socket_, buffer, size, flags);
}

INSTEAD(ssize_t, can_recv_checked, "__recv_chk", int fd, void *buffer, size_t size, size_t room, int flags)
{
    NEXT(ssize_t(*)(int, void *, size_t, size_t, int), __recv_chk);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next___recv_chk(fd, buffer, size, room, flags)
                           : take_into(fd, socket_, buffer, size < room ? size : room, flags);
}

static ssize_t take_from(int fd, struct can_socket *socket_, void *buffer, size_t size, int flags, void *address,
                         socklen_t *length)
{
    struct iovec part = {buffer, size};
    struct msghdr message = {0};
    ssize_t count;

    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_name = length == NULL ? NULL : address;
    message.msg_namelen = length == NULL ? 0 : *length;
    count = take(fd, socket_, &message, flags);
    if (count >= 0 && length != NULL && address != NULL)
        *length = message.msg_namelen;
    return count;
}

INSTEAD(ssize_t, can_recvfrom, "recvfrom", int fd, void *buffer, size_t size, int flags, struct sockaddr *address,
        socklen_t *length)
{
    NEXT(ssize_t(*)(int, void *, size_t, int, struct sockaddr *, socklen_t *), recvfrom);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_recvfrom(fd, buffer, size, flags, address, length)
                           : take_from(fd, socket_, buffer, size, flags, address, length);
}

INSTEAD(ssize_t, can_recvfrom_checked, "__recvfrom_chk", int fd, void *buffer, size_t size, size_t room, int flags,
        struct sockaddr *address, socklen_t *length)
{
    NEXT(ssize_t(*)(int, void *, size_t, size_t, int, struct sockaddr *, socklen_t *), __recvfrom_chk);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next___recvfrom_chk(fd, buffer, size, room, flags, address, length)
                           : take_from(fd, socket_, buffer, size < room ? size : room, flags, address, length);
}

INSTEAD(ssize_t, can_recvmsg, "recvmsg", int fd, struct msghdr *message, int flags)
{
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? receive_plain(fd, message, flags) : take(fd, socket_, message, flags);
}

INSTEAD(int, can_recvmmsg, "recvmmsg", int fd, struct mmsghdr *messages, unsigned int count, int flags,
        struct timespec *limit)
{
    NEXT(int (*)(int, struct mmsghdr *, unsigned int, int, struct timespec *), recvmmsg);
    struct can_socket *socket_ = find_carried(fd);
    unsigned int done;
    ssize_t size;

    if (socket_ == NULL)
        return next_recvmmsg(fd, messages, count, flags, limit);
    for (done = 0; done < count; done++) {
        int now = done != 0 && (flags & MSG_WAITFORONE) ? flags | MSG_DONTWAIT : flags;
        if ((size = take(fd, socket_, &messages[done].msg_hdr, now)) < 0)
            return done != 0 ? (int)done : -1;
        messages[done].msg_len = (unsigned int)size;
    }
    return (int)done;
}

static ssize_t put_from(int fd, struct can_socket *socket_, const void *buffer, size_t size, int flags,
                        const void *address, socklen_t length)
{
    struct iovec part = {(void *)(uintptr_t)buffer, size};
    struct msghdr message = {0};

    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_name = (void *)(uintptr_t)address;
    message.msg_namelen = length;
    return put(fd, socket_, &message, flags);
}

INSTEAD(ssize_t, can_write, "write", int fd, const void *buffer, size_t size)
{
    NEXT(ssize_t(*)(int, const void *, size_t), write);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_write(fd, buffer, size) : put_from(fd, socket_, buffer, size, 0, NULL, 0);
}

INSTEAD(ssize_t, can_writev, "writev", int fd, const struct iovec *parts, int count)
{
    NEXT(ssize_t(*)(int, const struct iovec *, int), writev);
    struct can_socket *socket_ = find_carried(fd);
    struct msghdr message = {0};

    if (socket_ == NULL)
        return next_writev(fd, parts, count);
    if (count < 0)
        return fail(EINVAL);
    message.msg_iov = (struct iovec *)(uintptr_t)parts;
    message.msg_iovlen = (size_t)count;
    return put(fd, socket_, &message, 0);
}

INSTEAD(ssize_t, can_send, "send", int fd, const void *buffer, size_t size, int flags)
{
    NEXT(ssize_t(*)(int, const void *, size_t, int), send);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_send(fd, buffer, size, flags) : put_from(fd, socket_, buffer, size, flags, NULL, 0);
}

INSTEAD(ssize_t, can_sendto, "sendto", int fd, const void *buffer, size_t size, int flags,
        const struct sockaddr *address, socklen_t length)
{
    NEXT(ssize_t(*)(int, const void *, size_t, int, const struct sockaddr *, socklen_t), sendto);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_sendto(fd, buffer, size, flags, address, length)
                           : put_from(fd, socket_, buffer, size, flags, address, length);
}

INSTEAD(ssize_t, can_sendmsg, "sendmsg", int fd, const struct msghdr *message, int flags)
{
    NEXT(ssize_t(*)(int, const struct msghdr *, int), sendmsg);
    struct can_socket *socket_ = find_carried(fd);
    return socket_ == NULL ? next_sendmsg(fd, message, flags) : put(fd, socket_, message, flags);
}

INSTEAD(int, can_sendmmsg, "sendmmsg", int fd, struct mmsghdr *messages, unsigned int count, int flags)
{
    NEXT(int (*)(int, struct mmsghdr *, unsigned int, int), sendmmsg);
    struct can_socket *socket_ = find_carried(fd);
    unsigned int done;
    ssize_t size;

    if (socket_ == NULL)
        return next_sendmmsg(fd, messages, count, flags);
    for (done = 0; done < count; done++) {
        if ((size = put(fd, socket_, &messages[done].msg_hdr, flags)) < 0)
            return done != 0 ? (int)done : -1;
        messages[done].msg_len = (unsigned int)size;
    }
    return (int)done;
}

INSTEAD(int, can_close, "close", int fd)
{
    if (fd >= 0 && fd < MAX_FDS && __atomic_load_n(&sockets[fd], __ATOMIC_ACQUIRE) != NULL && getpid() == owner) {
        pthread_mutex_lock(&guard);
        forget(fd);
        pthread_mutex_unlock(&guard);
    }
    return close_plain(fd);
}

INSTEAD(int, can_dup, "dup", int fd)
{
    NEXT(int (*)(int), dup);
    return copied(fd, next_dup(fd));
}

INSTEAD(int, can_dup2, "dup2", int from, int to)
{
    NEXT(int (*)(int, int), dup2);
    return copied(from, next_dup2(from, to));
}

INSTEAD(int, can_dup3, "dup3", int from, int to, int flags)
{
    NEXT(int (*)(int, int, int), dup3);
    return copied(from, next_dup3(from, to, flags));
}

INSTEAD(int, can_fcntl, "fcntl", int fd, int command, ...)
{
    NEXT(int (*)(int, int, ...), fcntl);
    va_list arguments;
    void *argument;
    int result;

    va_start(arguments, command);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    result = next_fcntl(fd, command, argument);
    return command == F_DUPFD || command == F_DUPFD_CLOEXEC ? copied(fd, result) : result;
}

INSTEAD(int, can_fcntl64, "fcntl64", int fd, int command, ...)
{
    NEXT(int (*)(int, int, ...), fcntl64);
    va_list arguments;
    void *argument;
    int result;

    va_start(arguments, command);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    if (next_fcntl64 == NULL) {
        NEXT(int (*)(int, int, ...), fcntl);
        next_fcntl64 = next_fcntl;
    }
    result = next_fcntl64(fd, command, argument);
    return command == F_DUPFD || command == F_DUPFD_CLOEXEC ? copied(fd, result) : result;
}

INSTEAD(unsigned int, can_if_nametoindex, "if_nametoindex", const char *name)
{
    NEXT(unsigned int (*)(const char *), if_nametoindex);
    unsigned int index = next_if_nametoindex(name);
    return index != 0 || name == NULL ? index : (unsigned int)index_of(name);
}

INSTEAD(char *, can_if_indextoname, "if_indextoname", unsigned int index, char *name)
{
    NEXT(char *(*)(unsigned int, char *), if_indextoname);
    const char *ours = name_of((int)index);

    if (ours == NULL)
        return next_if_indextoname(index, name);
    memset(name, 0, IFNAMSIZ);
    memcpy(name, ours, strlen(ours));
    return name;
}
