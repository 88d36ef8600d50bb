/* Stand-in for the part of the FreeRTOS kernel that the exported tasks use; written for the tests of surctl.
 *
 * Tasks run as contexts of one thread, on the stacks that their creator gives. Time is virtual: when every task waits, the clock
 * moves on to the first one that wakes. Names and types are those of the kernel's public documentation.
 */
#ifndef STUB_FREERTOS_H
#define STUB_FREERTOS_H

#include <stddef.h>
#include <stdint.h>

typedef long BaseType_t;
typedef unsigned long UBaseType_t;
typedef uint32_t TickType_t;
typedef size_t StackType_t;
typedef struct tskTaskControlBlock *TaskHandle_t;
typedef void (*TaskFunction_t)(void *);
typedef struct {
    void *reserved[256];
} StaticTask_t;

#define pdFALSE ((BaseType_t)0)
#define pdTRUE ((BaseType_t)1)
#define pdPASS (pdTRUE)
#define pdFAIL (pdFALSE)
#define configTICK_RATE_HZ ((TickType_t)1000)
#define configMAX_PRIORITIES (8)
#define configMINIMAL_STACK_SIZE ((unsigned short)1024)
#define configSTACK_DEPTH_TYPE size_t
#define tskIDLE_PRIORITY ((UBaseType_t)0U)

#endif
