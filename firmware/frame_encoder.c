/* Frames of the format "frames", version 1, in the caller's memory. C99 and C++. */
#include "frame_encoder.h"

#include <string.h>

static uint8_t *put(uint8_t *to, uint32_t number, int bytes) /* lowest byte first */
{
    for (; bytes > 0; bytes--, number >>= 8) *to++ = (uint8_t)number;
    return to;
}

size_t encode_frame(uint8_t out[LONGEST_FRAME], uint8_t stream, uint8_t type,
        const void *values, uint8_t n, uint32_t sequence, uint32_t time_us)
{
    uint8_t *at = out + 2, *code = out + 1; /* after delimiter and first code */
    const uint8_t *v = (const uint8_t *)values;
    uint32_t crc = 0xFFFFFFFFu, word;
    uint16_t half;
    if (n < 1 || n > (type == FLOAT32 ? 59 : type == INT16 ? 118 : 0)) return 0;
    *at++ = 1; *at++ = stream; *at++ = type; *at++ = n; /* version 1 */
    at = put(put(at, sequence, 4), time_us, 4);
    for (; n > 0; n--) { /* copied first: any alignment, any byte order */
        if (type == FLOAT32) { memcpy(&word, v, 4); at = put(at, word, 4); v += 4; }
        else { memcpy(&half, v, 2); at = put(at, half, 2); v += 2; }
    }
    for (const uint8_t *from = out + 2; from < at; from++) {
        crc ^= *from;
        for (int i = 0; i < 8; i++) crc = (crc >> 1) ^ (crc & 1u ? 0xEDB88320u : 0u);
    }
    at = put(at, ~crc, 4);
    for (uint8_t *from = out + 2; from < at; from++) /* COBS: from zero to zero */
        if (*from == 0) { *code = (uint8_t)(from - code); code = from; }
    *code = (uint8_t)(at - code);
    out[0] = *at = 0;
    return (size_t)(at + 1 - out);
}
