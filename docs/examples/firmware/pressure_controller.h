// Pressure controller of softrig's driver `serial`: line protocol, heartbeat, venting on silence.
//
// Plain C++11 without heap and without Arduino headers, so that the same file runs on a board and on the host. The
// caller passes the time and the bytes; see pressure_controller.ino and host.cpp. docs/reference/serial-protocol.md
// describes every line.
#pragma once

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

namespace softrig {

constexpr uint8_t kChannels = 4;
constexpr size_t kLongestLine = 120;

struct Limits {
  int32_t lowest_pa;   // set-points are gauge pressures
  int32_t highest_pa;
  int32_t vent_pa;
  uint32_t silence_us;
};

enum State : uint8_t { kVented = 0, kDriven = 1, kSilent = 2 };

// CRC-16/XMODEM.
inline uint16_t crc16(const char* text, size_t length) {
  uint16_t crc = 0;
  for (size_t i = 0; i < length; ++i) {
    crc ^= static_cast<uint16_t>(static_cast<uint8_t>(text[i])) << 8;
    for (uint8_t bit = 0; bit < 8; ++bit) {
      crc = crc & 0x8000 ? static_cast<uint16_t>((crc << 1) ^ 0x1021) : static_cast<uint16_t>(crc << 1);
    }
  }
  return crc;
}

class Controller {
 public:
  using Send = void (*)(const char* text, size_t length);

  Controller(const Limits& limits, Send send) : limits_(limits), send_(send) { vent(kVented); }

  int32_t setpoint_pa(uint8_t channel) const { return setpoint_pa_[channel]; }
  State state() const { return state_; }

  // One received byte.
  void receive(char byte, uint32_t now_us) {
    if (byte != '\n') {
      if (length_ < kLongestLine) line_[length_] = byte;
      if (length_ <= kLongestLine) ++length_;
      return;
    }
    const size_t length = length_;
    length_ = 0;
    if (length > kLongestLine || !checked(length)) {
      ++rejected_;
    } else if (!obey(now_us)) {
      ++rejected_;
    }
  }

  // Vents on silence; sends a status when one is due. Call at least every millisecond.
  void step(uint32_t now_us, const int32_t* measured_pa) {
    if (state_ == kDriven && now_us - heard_us_ > limits_.silence_us) vent(kSilent);
    if (period_us_ == 0 || now_us - status_us_ < period_us_) return;
    status_us_ += period_us_;
    if (now_us - status_us_ >= period_us_) status_us_ = now_us;  // after a stall, no burst
    status(now_us, measured_pa);
  }

 private:
  // Remove the checksum of a line; false if it is wrong.
  bool checked(size_t length) {
    if (length < 6 || line_[length - 5] != '*') return false;
    line_[length] = '\0';
    char* end = nullptr;
    const unsigned long stated = strtoul(line_ + length - 4, &end, 16);
    line_[length - 5] = '\0';
    return *end == '\0' && stated == crc16(line_, length - 5);
  }

  bool obey(uint32_t now_us) {
    char* rest = line_ + 1;
    switch (line_[0]) {
      case 'Q':
        return *rest == '\0' && begin_session();
      case 'R': {
        int32_t period = 0;
        if (!number(&rest, &period) || *rest != '\0' || period < 0 || (period > 0 && period < 1000)) return false;
        period_us_ = static_cast<uint32_t>(period);
        status_us_ = now_us;
        count_ = 0;
        return true;
      }
      case 'W':
        return write(rest, now_us);
      default:
        return false;
    }
  }

  bool begin_session() {
    fresh_ = true;
    if (state_ == kSilent) state_ = kVented;
    char text[kLongestLine];
    snprintf(text, sizeof text, "I softrig 1 %u %ld %ld %ld %lu", kChannels, static_cast<long>(limits_.lowest_pa),
             static_cast<long>(limits_.highest_pa), static_cast<long>(limits_.vent_pa),
             static_cast<unsigned long>(limits_.silence_us));
    send(text);
    return true;
  }

  bool write(char* rest, uint32_t now_us) {
    int32_t sequence = 0;
    int32_t asked[kChannels];
    if (!number(&rest, &sequence) || sequence < 0 || sequence > 65535) return false;
    for (uint8_t i = 0; i < kChannels; ++i) {
      if (!number(&rest, &asked[i]) || asked[i] < limits_.lowest_pa || asked[i] > limits_.highest_pa) return false;
    }
    if (*rest != '\0' || state_ == kSilent) return false;  // after silence only a new session drives
    const uint16_t newer = static_cast<uint16_t>(static_cast<uint16_t>(sequence) - sequence_);
    if (!fresh_ && (newer == 0 || newer > 32767)) return false;
    fresh_ = false;
    sequence_ = static_cast<uint16_t>(sequence);
    heard_us_ = now_us;
    bool vents = true;
    for (uint8_t i = 0; i < kChannels; ++i) {
      setpoint_pa_[i] = asked[i];
      vents = vents && asked[i] == limits_.vent_pa;
    }
    state_ = vents ? kVented : kDriven;
    acknowledge();
    return true;
  }

  void acknowledge() {
    char text[kLongestLine];
    int used = snprintf(text, sizeof text, "A %u %u", sequence_, state_);
    append(text, used, setpoint_pa_);
  }

  void status(uint32_t now_us, const int32_t* measured_pa) {
    char text[kLongestLine];
    int used = snprintf(text, sizeof text, "S %lu %lu %u %u", static_cast<unsigned long>(count_++),
                        static_cast<unsigned long>(now_us), state_, rejected_);
    append(text, used, measured_pa);
  }

  void append(char* text, int used, const int32_t* values) {
    for (uint8_t i = 0; i < kChannels; ++i) {
      used += snprintf(text + used, kLongestLine - static_cast<size_t>(used), " %ld", static_cast<long>(values[i]));
    }
    send(text);
  }

  void send(const char* text) {
    char whole[kLongestLine + 7];
    const size_t length = strlen(text);
    const int all = snprintf(whole, sizeof whole, "%s*%04X\n", text, crc16(text, length));
    send_(whole, static_cast<size_t>(all));
  }

  // A blank and a whole number.
  static bool number(char** rest, int32_t* value) {
    if (**rest != ' ') return false;
    char* begin = *rest + 1;
    if (*begin != '-' && (*begin < '0' || *begin > '9')) return false;
    char* end = nullptr;
    const long found = strtol(begin, &end, 10);
    if (end == begin || found < -100000000L || found > 100000000L) return false;
    *value = static_cast<int32_t>(found);
    *rest = end;
    return true;
  }

  void vent(State state) {
    for (uint8_t i = 0; i < kChannels; ++i) setpoint_pa_[i] = limits_.vent_pa;
    state_ = state;
  }

  Limits limits_;
  Send send_;
  char line_[kLongestLine + 1] = {};
  size_t length_ = 0;
  int32_t setpoint_pa_[kChannels] = {};
  State state_ = kVented;
  bool fresh_ = true;
  uint16_t sequence_ = 0;
  uint16_t rejected_ = 0;
  uint32_t heard_us_ = 0;
  uint32_t period_us_ = 0;
  uint32_t status_us_ = 0;
  uint32_t count_ = 0;
};

}  // namespace softrig
