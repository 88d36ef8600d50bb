#ifndef STUB_TASK_H
#define STUB_TASK_H

#include "FreeRTOS.h"

TaskHandle_t xTaskCreateStatic(TaskFunction_t code, const char *const name, const configSTACK_DEPTH_TYPE depth,
    void *const parameters, UBaseType_t priority, StackType_t *const stack, StaticTask_t *const buffer);
BaseType_t xTaskDelayUntil(TickType_t *const previous, const TickType_t increment);
void vTaskDelay(const TickType_t ticks);
void vTaskSuspend(TaskHandle_t task);
TickType_t xTaskGetTickCount(void);
UBaseType_t uxTaskGetStackHighWaterMark(TaskHandle_t task);
void vTaskStartScheduler(void);

/* Of the stand-in alone: the running task computes for this long; tasks of higher priority do not interrupt it. */
void stub_busy(TickType_t ticks);

#endif
