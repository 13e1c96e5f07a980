// A CAN driver of ours in the style of those of ROS (socketcan_interface, ros2_socketcan, the ARS408 drivers): a class
// around a socket, a thread that waits by poll or epoll and reads without blocking, a callback, a sender of its own.
//   ros_driver INTERFACE COUNT poll|epoll
// Prints "ready", then COUNT frames "ID LENGTH DATA SECONDS.MICROSECONDS", one of them answered by a frame 0x200.
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <functional>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/sockios.h>
#include <net/if.h>
#include <poll.h>
#include <stdexcept>
#include <string>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

class CanInterface
{
public:
    using Callback = std::function<void(const can_frame &, const timeval &)>;

    explicit CanInterface(const std::string &name)
    {
        socket_ = check(::socket(PF_CAN, SOCK_RAW, CAN_RAW), "socket");
        ifreq request{};
        std::strncpy(request.ifr_name, name.c_str(), IFNAMSIZ - 1);
        check(::ioctl(socket_, SIOCGIFINDEX, &request), "SIOCGIFINDEX");
        const can_err_mask_t errors = CAN_ERR_MASK;
        check(::setsockopt(socket_, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors), "error filter");
        const int off = 0, on = 1;
        check(::setsockopt(socket_, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &off, sizeof off), "own messages");
        check(::setsockopt(socket_, SOL_SOCKET, SO_TIMESTAMP, &on, sizeof on), "time stamps");
        // Apollo asks for a filter per identifier and for CAN FD, on a classical bus
        std::vector<can_filter> filters(2048);
        for (canid_t id = 0; id < filters.size(); ++id)
            filters[id] = {id, CAN_SFF_MASK};
        check(::setsockopt(socket_, SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                           static_cast<socklen_t>(filters.size() * sizeof(can_filter))), "filters");
        check(::setsockopt(socket_, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on), "FD frames");
        sockaddr_can address{};
        address.can_family = AF_CAN;
        address.can_ifindex = request.ifr_ifindex;
        check(::bind(socket_, reinterpret_cast<sockaddr *>(&address), sizeof address), "bind");
        check(::fcntl(socket_, F_SETFL, ::fcntl(socket_, F_GETFL) | O_NONBLOCK), "O_NONBLOCK");
        sender_ = check(::dup(socket_), "dup");
        // a helper is started as libraries do it: the child of vfork shares our memory and closes what it inherits
        const pid_t child = ::vfork();
        if (child == 0) {
            ::close(socket_);
            ::close(sender_);
            ::_exit(0);
        }
        ::waitpid(child, nullptr, 0);
    }

    ~CanInterface()
    {
        stop_ = true;
        if (thread_.joinable())
            thread_.join();
        ::close(sender_);
        ::close(socket_);
    }

    void start(bool epoll, Callback callback)
    {
        thread_ = std::thread([this, epoll, callback] { run(epoll, callback); });
    }

    void send(const can_frame &frame)
    {
        if (::write(sender_, &frame, sizeof frame) != static_cast<ssize_t>(sizeof frame))
            throw std::runtime_error(std::string("write: ") + std::strerror(errno));
    }

private:
    static int check(int result, const char *what)
    {
        if (result < 0)
            throw std::runtime_error(std::string(what) + ": " + std::strerror(errno));
        return result;
    }

    void run(bool epoll, const Callback &callback)
    {
        int waiter = -1;
        if (epoll) {
            waiter = check(::epoll_create1(EPOLL_CLOEXEC), "epoll");
            epoll_event event{};
            event.events = EPOLLIN | EPOLLET;
            check(::epoll_ctl(waiter, EPOLL_CTL_ADD, socket_, &event), "epoll_ctl");
        }
        while (!stop_) {
            pollfd one{socket_, POLLIN, 0};
            epoll_event event{};
            if ((epoll ? ::epoll_wait(waiter, &event, 1, 50) : ::poll(&one, 1, 50)) <= 0)
                continue;
            while (read_one(callback)) {
            }
        }
        if (waiter >= 0)
            ::close(waiter);
    }

    bool read_one(const Callback &callback)
    {
        can_frame frame;
        iovec part{&frame, sizeof frame};
        char control[CMSG_SPACE(sizeof(timeval))];
        msghdr message{};
        message.msg_iov = &part;
        message.msg_iovlen = 1;
        message.msg_control = control;
        message.msg_controllen = sizeof control;
        const ssize_t size = ::recvmsg(socket_, &message, 0);
        if (size != static_cast<ssize_t>(sizeof frame))
            return false;
        timeval time{};
        for (cmsghdr *one = CMSG_FIRSTHDR(&message); one != nullptr; one = CMSG_NXTHDR(&message, one))
            if (one->cmsg_level == SOL_SOCKET && one->cmsg_type == SO_TIMESTAMP)
                std::memcpy(&time, CMSG_DATA(one), sizeof time);
        timeval asked{};
        if (::ioctl(socket_, SIOCGSTAMP, &asked) != 0 || asked.tv_sec != time.tv_sec || asked.tv_usec != time.tv_usec)
            std::printf("SIOCGSTAMP differs\n");
        callback(frame, time);
        return true;
    }

    int socket_ = -1, sender_ = -1;
    std::atomic<bool> stop_{false};
    std::thread thread_;
};

int main(int count, char **arguments)
{
    if (count != 4)
        return 2;
    try {
        CanInterface can(arguments[1]);
        std::atomic<int> left{std::atoi(arguments[2])};
        can.start(std::string(arguments[3]) == "epoll", [&](const can_frame &frame, const timeval &time) {
            std::printf("%X %d ", frame.can_id, frame.can_dlc);
            for (int k = 0; k < frame.can_dlc; ++k)
                std::printf("%02X", frame.data[k]);
            std::printf(" %ld.%06ld\n", static_cast<long>(time.tv_sec), static_cast<long>(time.tv_usec));
            if (--left == 0) {
                can_frame answer{};
                answer.can_id = 0x200;
                answer.can_dlc = 2;
                answer.data[0] = 0xB9;
                can.send(answer);
            }
        });
        std::printf("ready\n");
        std::fflush(stdout);
        while (left > 0)
            ::usleep(1000);
    } catch (const std::exception &error) {
        std::printf("failed: %s\n", error.what());
        return 1;
    }
    return 0;
}
