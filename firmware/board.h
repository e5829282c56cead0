/* What the sketches need of a board: a clock, a serial line, one reset pin. board.c has it for the ATmega328P. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How often the board began anew since power was applied: by a brown-out, the reset pin, the watchdog. */
extern uint16_t board_resets;
/* Why it began: 1 power applied, 2 reset pin, 4 brown-out, 8 watchdog; 0 if a bootloader took the answer. */
extern uint8_t board_reset_cause;

void board_begin(uint32_t baud);
/* The clock [us]; wraps after 71.6 minutes. */
uint32_t board_micros(void);
void board_wait_until(uint32_t time_us);
/* Take bytes to be sent all together, or none of them; return whether. Never waits. */
bool board_send(const uint8_t *bytes, size_t n);
/* Pin 4 of an Arduino (PD4) low for 2 us: resets a TCA9548A, which lets go of all its branches. */
void board_pulse_reset(void);

/* The sketch. */
void setup(void);
void loop(void);

#ifdef __cplusplus
}
#endif
#endif
