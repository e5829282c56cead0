/* I2C as its master, at 400 kHz, that never waits for ever. twi.c has it for the ATmega328P. */
#ifndef TWI_H
#define TWI_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    TWI_OK,
    TWI_NO_ANSWER, /* nobody has that address, or it refused a byte */
    TWI_STUCK      /* a line was held low for too long; what was read is not to be trusted */
};

/* How often a held line was to be freed by clock pulses. */
extern uint16_t twi_recoveries;

void twi_begin(void);
/* Write bytes to an address, then read some; either number may be 0, not both. */
uint8_t twi_transfer(uint8_t address, const uint8_t *out, uint8_t n_out, uint8_t *in, uint8_t n_in);

#ifdef __cplusplus
}
#endif
#endif
