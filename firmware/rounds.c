#include "rounds.h"

#include "board.h"
#include "frame_encoder.h"
#include "twi.h"

enum { COUNTS = 5 };

static const uint32_t STATUS_US = 1000000;

static uint32_t interval_us, next_us, next_status_us, next_number, status_number, unsent, late;
static uint32_t missing[MOST_SENSORS];
static uint8_t sensor_count;
static uint8_t frame[LONGEST_FRAME];

void send_readings(uint8_t stream, const float *values, uint8_t n, round_t of)
{
    if (!board_send(frame, encode_frame(frame, stream, FLOAT32, values, n, of.number, of.time_us))) unsent++;
}

void rounds_begin(uint32_t baud, uint32_t period_us, uint8_t sensors)
{
    board_begin(baud);
    twi_begin();
    interval_us = period_us;
    sensor_count = sensors;
    next_us = next_status_us = board_micros() + period_us;
}

round_t next_round(void)
{
    round_t now;
    if ((int32_t)(board_micros() - next_us) > (int32_t)interval_us) { /* more than a round behind: begin anew */
        late++;
        next_us = board_micros();
    }
    board_wait_until(next_us);
    next_us += interval_us;
    now.number = next_number++;
    now.time_us = board_micros();
    return now;
}

void count_missing(uint8_t sensor) { missing[sensor]++; }

void send_status_when_due(void)
{
    float values[COUNTS + MOST_SENSORS];
    round_t now;
    now.time_us = board_micros();
    if ((int32_t)(now.time_us - next_status_us) < 0) return;
    next_status_us += STATUS_US;
    now.number = status_number++;
    values[0] = board_resets;
    values[1] = board_reset_cause;
    values[2] = (float)unsent;
    values[3] = (float)late;
    values[4] = twi_recoveries;
    for (uint8_t i = 0; i < sensor_count; i++) values[COUNTS + i] = (float)missing[i];
    send_readings(STATUS_STREAM, values, (uint8_t)(COUNTS + sensor_count), now);
}
