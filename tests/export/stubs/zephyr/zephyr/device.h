#ifndef STUB_DEVICE_H
#define STUB_DEVICE_H

#include <stdbool.h>

struct device {
    int ready;
};
extern const struct device stub_watchdog;

#define DT_ALIAS(name) stub_##name
#define stub_watchdog0 stub_watchdog
#define DEVICE_DT_GET_OR_NULL(node) (&node)

bool device_is_ready(const struct device *device);

#endif
