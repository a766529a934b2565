// Pressure controller for a board with PWM outputs to proportional regulators and analogue pressure sensors.
// Change the pins, the scales and the limits to yours. The outputs vent while the board resets: wire them so that 0 %
// duty vents.
#if defined(__AVR__)
#include <avr/wdt.h>
#endif

#include "pressure_controller.h"

using softrig::kChannels;

const uint8_t kOutputPins[kChannels] = {3, 5, 6, 9};
const uint8_t kSensorPins[kChannels] = {A0, A1, A2, A3};
const softrig::Limits kLimits = {0, 150000, 0, 50000};  // lowest, highest, vent [Pa]; silence [us]
const int32_t kRegulatorPa = 200000;                    // at 100 % duty
const int32_t kSensorPa = 1000000;                      // at full scale of the converter

void sendLine(const char* text, size_t length) { Serial.write(text, length); }

softrig::Controller controller(kLimits, sendLine);

void setup() {
  for (uint8_t i = 0; i < kChannels; ++i) pinMode(kOutputPins[i], OUTPUT);
  Serial.begin(500000);
#if defined(__AVR__)
  wdt_enable(WDTO_60MS);  // a program that hangs is reset; the reset vents
#endif
}

void loop() {
#if defined(__AVR__)
  wdt_reset();
#endif
  const uint32_t now_us = micros();
  while (Serial.available() > 0) controller.receive(static_cast<char>(Serial.read()), now_us);
  int32_t measured_pa[kChannels];
  for (uint8_t i = 0; i < kChannels; ++i) {
    measured_pa[i] = static_cast<int32_t>(static_cast<int64_t>(analogRead(kSensorPins[i])) * kSensorPa / 1023);
  }
  controller.step(now_us, measured_pa);
  for (uint8_t i = 0; i < kChannels; ++i) {
    analogWrite(kOutputPins[i], static_cast<int>(static_cast<int64_t>(controller.setpoint_pa(i)) * 255 / kRegulatorPa));
  }
}
