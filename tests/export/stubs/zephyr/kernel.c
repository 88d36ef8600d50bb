#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>
#include <zephyr/task_wdt/task_wdt.h>

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

const struct device stub_watchdog = { 1 };
static int64_t now;
static int64_t fed;
static int64_t allowed;

bool device_is_ready(const struct device *device) { return device->ready; }

void k_timer_start(struct k_timer *timer, k_timeout_t duration, k_timeout_t period)
{
    timer->period = period.us;
    timer->expires = now + duration.us;
}

uint32_t k_timer_status_sync(struct k_timer *timer)
{
    uint32_t expired = 0;
    now = (now < timer->expires) ? timer->expires : now;
    for (; timer->expires <= now; timer->expires += timer->period) { ++expired; }
    return expired;
}

int task_wdt_init(const struct device *hardware) { return (hardware == &stub_watchdog) ? 0 : -1; }

int task_wdt_add(uint32_t reload_period, task_wdt_callback_t callback, void *user_data)
{
    (void)user_data;
    allowed = 1000 * (int64_t)reload_period;
    fed = now;
    return (callback == NULL) ? 3 : -22;
}

int task_wdt_feed(int channel_id)
{
    if (now - fed > allowed) { exit(8); } /* the watchdog resets the processor */
    fed = now;
    return (channel_id == 3) ? 0 : -22;
}

void stub_busy(int64_t us) { now += us; }
int64_t stub_fed(void) { return fed; }

void printk(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    (void)vfprintf(stderr, format, values);
    va_end(values);
}
