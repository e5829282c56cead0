/* Frames of the format "frames", version 1, in the caller's memory. C99 and C++. */
#ifndef FRAME_ENCODER_H
#define FRAME_ENCODER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { FLOAT32 = 1, INT16 = 2, LONGEST_FRAME = 255 };

/* Write a frame of n floats or int16_t; return its length, 0 if they do not fit. */
size_t encode_frame(uint8_t out[LONGEST_FRAME], uint8_t stream, uint8_t type,
        const void *values, uint8_t n, uint32_t sequence, uint32_t time_us);

#ifdef __cplusplus
}
#endif
#endif
