/* All that C in these images wants of a C library; the functions are Rust's. */
#ifndef BIMANUAL_STRING_H
#define BIMANUAL_STRING_H
#include <stddef.h>
void *memcpy(void *to, const void *from, size_t bytes);
void *memmove(void *to, const void *from, size_t bytes);
void *memset(void *to, int byte, size_t bytes);
int memcmp(const void *a, const void *b, size_t bytes);
#endif
