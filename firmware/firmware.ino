/* Sends the readings of a few sensors as frames, 100 times per second. Nobody has run this on hardware yet. */
#include <math.h>

#include "frame_encoder.h"

enum { SENSORS = 3 };
static const uint32_t BAUD = 115200, PERIOD_US = 10000;
static float values[SENSORS];
static uint8_t frame[LONGEST_FRAME];
static uint32_t sequence, next_us;

/* Flux density in mT, NAN without a reading. Put your sensor here: this one has 100 mV/mT, 10 bits of 5 V. */
static float read_sensor(int i)
{
    const int counts = analogRead(A0 + i);
    return counts > 0 && counts < 1023 ? (counts - 512) * (5000.0f / 1024 / 100) : NAN;
}

void setup()
{
    Serial.begin(BAUD);
    next_us = micros();
}

void loop()
{
    while ((int32_t)(micros() - next_us) < 0) {}
    const uint32_t time_us = micros();
    next_us += PERIOD_US;
    if ((int32_t)(time_us - next_us) > 0) next_us = time_us; /* more than a period behind: begin anew */
    for (int i = 0; i < SENSORS; i++) values[i] = read_sensor(i);
    Serial.write(frame, encode_frame(frame, 0, FLOAT32, values, SENSORS, sequence++, time_us));
}
