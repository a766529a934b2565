// The pressure controller on the host: lines on standard input and output, chambers that follow with a time constant.
// Standard error reports each change of state with the time since the last received byte. Ends with its input. The
// argument is the silence [us] after which it vents, 50000 by default.
#include <fcntl.h>
#include <poll.h>
#include <time.h>
#include <unistd.h>

#include <cmath>

#include "pressure_controller.h"

namespace {

constexpr double kLagS = 0.05;

uint64_t micros64() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<uint64_t>(now.tv_sec) * 1000000u + static_cast<uint64_t>(now.tv_nsec) / 1000u;
}

void sendLine(const char* text, size_t length) {
  if (write(STDOUT_FILENO, text, length) < 0) return;  // no reader: a serial line drops it, too
}

}  // namespace

int main(int count, char** arguments) {
  const uint32_t silence_us = count > 1 ? static_cast<uint32_t>(strtoul(arguments[1], nullptr, 10)) : 50000;
  const softrig::Limits limits = {-80000, 150000, 0, silence_us};
  softrig::Controller controller(limits, sendLine);
  double chamber_pa[softrig::kChannels] = {};
  uint64_t before = micros64(), received = before;
  softrig::State state = controller.state();
  fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
  fcntl(STDOUT_FILENO, F_SETFL, O_NONBLOCK);
  for (;;) {
    pollfd input = {STDIN_FILENO, POLLIN, 0};
    const bool ready = poll(&input, 1, 1) > 0;
    const uint64_t now = micros64();
    char bytes[256];
    const ssize_t got = ready ? read(STDIN_FILENO, bytes, sizeof bytes) : -1;
    if (got == 0) return 0;
    for (ssize_t i = 0; i < got; ++i) controller.receive(bytes[i], static_cast<uint32_t>(now));
    if (got > 0) received = now;
    const double share = -std::expm1(-static_cast<double>(now - before) * 1e-6 / kLagS);
    before = now;
    int32_t measured_pa[softrig::kChannels];
    for (uint8_t i = 0; i < softrig::kChannels; ++i) {
      chamber_pa[i] += share * (controller.setpoint_pa(i) - chamber_pa[i]);
      measured_pa[i] = static_cast<int32_t>(std::lround(chamber_pa[i]));
    }
    controller.step(static_cast<uint32_t>(now), measured_pa);
    if (controller.state() != state) {
      state = controller.state();
      dprintf(STDERR_FILENO, "state %d %llu\n", state, static_cast<unsigned long long>(now - received));
    }
  }
}
