/* Rounds of readings at a steady rate, their frames, and once a second a frame of what went wrong. */
#ifndef ROUNDS_H
#define ROUNDS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { STATUS_STREAM = 255, MOST_SENSORS = 16 };

typedef struct {
    uint32_t number;  /* from 0: the sequence number of its frames, whether they could be sent or not */
    uint32_t time_us; /* when it begins */
} round_t;

void rounds_begin(uint32_t baud, uint32_t period_us, uint8_t sensors);
/* Wait for the next round. */
round_t next_round(void);
/* Send the readings of a round, or count the frame as not sent. NaN is a reading that is missing. */
void send_readings(uint8_t stream, const float *values, uint8_t n, round_t of);
/* Count a sensor, from 0, that gave no reading. */
void count_missing(uint8_t sensor);
/* Once a second, send what was counted. */
void send_status_when_due(void);

#ifdef __cplusplus
}
#endif
#endif
