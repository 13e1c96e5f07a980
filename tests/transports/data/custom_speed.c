/*
 * What drivers of the LMS2xx do to a port on their way to 500 000 baud and back, call by call, as read in
 *   sicktoolbox  c++/drivers/lms2xx/sicklms2xx/SickLMS2xx.cc, _setTerminalBaud
 *   Player       server/drivers/laser/sicklms200.cc, ChangeTermSpeed, serial_high_speed_mode 0
 *   old CARMEN / Orca: refuse a port whose TIOCGSERIAL fails, at every speed
 * Reads one command a line on standard input, answers "ok ..." or "failed ..." on standard output.
 */
#include <errno.h>
#include <fcntl.h>
#include <linux/serial.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

static int port;

static int set_termios(speed_t speed)
{
    struct termios modes;

    if (tcgetattr(port, &modes) < 0)
        return -1;
    cfmakeraw(&modes);
    cfsetispeed(&modes, speed);
    cfsetospeed(&modes, speed);
    return tcsetattr(port, TCSAFLUSH, &modes);
}

static int custom_flag(int on)
{
    struct serial_struct serial;

    if (ioctl(port, TIOCGSERIAL, &serial) < 0)
        return -1;
    if (on) {
        serial.flags |= ASYNC_SPD_CUST;
        serial.custom_divisor = 48;
    } else {
        serial.flags &= ~ASYNC_SPD_CUST;
        serial.custom_divisor = 0;
    }
    return ioctl(port, TIOCSSERIAL, &serial);
}

/* sicktoolbox: flag first, then B38400. */
static int sicktoolbox_500k(void)
{
    return custom_flag(1) < 0 ? -1 : set_termios(B38400);
}

/* sicktoolbox: the flag is cleared before every standard rate; errors are only logged. */
static int sicktoolbox_standard(speed_t speed)
{
    custom_flag(0);
    return set_termios(speed);
}

/* Player: clears the flag, then sets it, then B38400. */
static int player_500k(void)
{
    custom_flag(0);
    return custom_flag(1) < 0 ? -1 : set_termios(B38400);
}

/* The divisor worked out from the port's own base, as generic code does; termios first, flag behind it. */
static int computed_500k(void)
{
    struct serial_struct serial;

    if (set_termios(B38400) < 0 || ioctl(port, TIOCGSERIAL, &serial) < 0)
        return -1;
    serial.flags = (serial.flags & ~ASYNC_SPD_MASK) | ASYNC_SPD_CUST;
    serial.custom_divisor = (serial.baud_base + 500000 / 2) / 500000;
    return ioctl(port, TIOCSSERIAL, &serial);
}

/* The same through the kernel's own calls instead of tcsetattr. */
static int by_ioctl(uint32_t code)
{
    uint32_t modes[16];

    if (ioctl(port, 0x5401 /* TCGETS */, modes) < 0)
        return -1;
    modes[2] = (modes[2] & ~(uint32_t)0x100F) | code;
    return ioctl(port, 0x5402 /* TCSETS */, modes);
}

static int vhi_flag(void)
{
    struct serial_struct serial;

    if (ioctl(port, TIOCGSERIAL, &serial) < 0)
        return -1;
    serial.flags = (serial.flags & ~ASYNC_SPD_MASK) | ASYNC_SPD_VHI;
    return ioctl(port, TIOCSSERIAL, &serial) < 0 ? -1 : set_termios(B38400);
}

static void *hammer(void *failures)
{
    int turn;

    for (turn = 0; turn < 300; turn++)
        if (custom_flag(turn & 1) < 0 || set_termios(B38400) < 0)
            ++*(int *)failures;
    return NULL;
}

static int threads(void)
{
    pthread_t workers[4];
    int failures[4] = {0}, index, all = 0;

    for (index = 0; index < 4; index++)
        pthread_create(&workers[index], NULL, hammer, &failures[index]);
    for (index = 0; index < 4; index++) {
        pthread_join(workers[index], NULL);
        all += failures[index];
    }
    return all == 0 ? sicktoolbox_500k() : -1;
}

static int read_back(void)
{
    struct termios modes;
    struct serial_struct serial;

    if (tcgetattr(port, &modes) < 0)
        return -1;
    memset(&serial, 0, sizeof serial);
    ioctl(port, TIOCGSERIAL, &serial);
    printf("speed %s flags %#x divisor %d base %d ", cfgetospeed(&modes) == B38400 ? "B38400" : "other",
           serial.flags & ASYNC_SPD_MASK, serial.custom_divisor, serial.baud_base);
    return 0;
}

/* struct termios2 made from nothing, no TCGETS2 before: any speed as a number. */
static int blind_speed(uint32_t speed)
{
    struct {
        uint32_t iflag, oflag, cflag, lflag;
        uint8_t line, cc[19];
        uint32_t ispeed, ospeed;
    } modes;

    memset(&modes, 0, sizeof modes);
    modes.cflag = 0x1000 /* BOTHER */ | CS8 | CREAD | CLOCAL;
    modes.ispeed = modes.ospeed = speed;
    return ioctl(port, 0x402C542DUL /* TCSETSF2 */, &modes);
}

static int get_lines(void)
{
    int bits = 0;

    if (ioctl(port, TIOCMGET, &bits) < 0)
        return -1;
    printf("%s%s%s ", bits & TIOCM_DTR ? "DTR " : "", bits & TIOCM_RTS ? "RTS " : "",
           (bits & (TIOCM_CTS | TIOCM_DSR | TIOCM_CAR)) == (TIOCM_CTS | TIOCM_DSR | TIOCM_CAR) ? "device" : "");
    return 0;
}

/* "set dtr", "up rts", "down dtr": mono's SerialPort sets both so, from what TIOCMGET gave. */
static int set_lines(const char *text)
{
    int bits = strstr(text, "dtr") != NULL ? TIOCM_DTR : strstr(text, "rts") != NULL ? TIOCM_RTS : 0;

    return ioctl(port, strncmp(text, "set", 3) == 0 ? TIOCMSET : strncmp(text, "up", 2) == 0 ? TIOCMBIS : TIOCMBIC, &bits);
}

static int plain_file(void)
{
    struct serial_struct serial;
    int file = open("/dev/null", O_RDWR), failed;

    failed = ioctl(file, TIOCGSERIAL, &serial) < 0 && errno == ENOTTY && ioctl(port, TIOCGSERIAL, NULL) < 0;
    close(file);
    return failed ? 0 : -1;
}

int main(int count, char **arguments)
{
    char line[64];
    struct serial_icounter_struct counters;

    if (count != 2 || (port = open(arguments[1], O_RDWR | O_NOCTTY | O_NDELAY)) < 0)
        return 2;
    while (fgets(line, sizeof line, stdin) != NULL) {
        int result;
        line[strcspn(line, "\n")] = '\0';
        if (strcmp(line, "sicktoolbox 500000") == 0)
            result = sicktoolbox_500k();
        else if (strcmp(line, "sicktoolbox 38400") == 0)
            result = sicktoolbox_standard(B38400);
        else if (strcmp(line, "sicktoolbox 9600") == 0)
            result = sicktoolbox_standard(B9600);
        else if (strcmp(line, "player 500000") == 0)
            result = player_500k();
        else if (strcmp(line, "computed 500000") == 0)
            result = computed_500k();
        else if (strcmp(line, "ioctl 500000") == 0)
            result = custom_flag(1) < 0 ? -1 : by_ioctl(0x0F);
        else if (strcmp(line, "ioctl 9600") == 0)
            result = by_ioctl(0x0D);
        else if (strcmp(line, "clear") == 0)
            result = custom_flag(0);
        else if (strcmp(line, "native 500000") == 0)
            result = set_termios(B500000);
        else if (strcmp(line, "vhi") == 0)
            result = vhi_flag();
        else if (strcmp(line, "threads") == 0)
            result = threads();
        else if (strncmp(line, "blind ", 6) == 0)
            result = blind_speed((uint32_t)atoi(line + 6));
        else if (strcmp(line, "get lines") == 0)
            result = get_lines();
        else if (strncmp(line, "lines ", 6) == 0)
            result = set_lines(line + 6);
        else if (strcmp(line, "count") == 0)
            result = ioctl(port, TIOCGICOUNT, &counters);
        else if (strcmp(line, "read back") == 0)
            result = read_back();
        else if (strcmp(line, "plain file") == 0)
            result = plain_file();
        else if (strcmp(line, "telegram") == 0)
            result = write(port, "\x02\x00\x01\x00\x31\x15\x12", 7) == 7 ? 0 : -1;
        else
            return 3;
        if (result == 0)
            printf("ok\n");
        else
            printf("failed %s\n", strerror(errno));
        fflush(stdout);
    }
    return 0;
}
