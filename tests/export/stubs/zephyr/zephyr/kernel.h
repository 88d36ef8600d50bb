/* Stand-in for the part of the Zephyr kernel that the exported sample uses; written for the tests of surctl. Time is virtual: the
 * timer expires when it is waited for. Names and types are those of Zephyr's public documentation.
 */
#ifndef STUB_ZEPHYR_H
#define STUB_ZEPHYR_H

#include <stdint.h>

typedef struct {
    int64_t us;
} k_timeout_t;
struct k_timer {
    int64_t period;
    int64_t expires;
};

#define K_USEC(us) ((k_timeout_t){ (us) })
#define K_TIMER_DEFINE(name, expiry, stop) \
    struct k_timer name = { ((expiry) == NULL && (stop) == NULL) ? 0 : -1, 0 }

void k_timer_start(struct k_timer *timer, k_timeout_t duration, k_timeout_t period);
uint32_t k_timer_status_sync(struct k_timer *timer);

/* Of the stand-in alone: the running thread computes for this long [us]. */
void stub_busy(int64_t us);
int64_t stub_fed(void); /* time of the last feed [us] */

#endif
