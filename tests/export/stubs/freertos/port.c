#include "task.h"

#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

enum { MOST = 4, PATTERN = 0xa5 };

struct tskTaskControlBlock {
    ucontext_t context;
    TaskFunction_t code;
    void *parameters;
    UBaseType_t priority;
    TickType_t wakes;
    int suspended;
    unsigned char *stack;
    size_t bytes;
};

typedef char fits[(sizeof(struct tskTaskControlBlock) <= sizeof(StaticTask_t)) ? 1 : -1];

static TaskHandle_t tasks[MOST];
static int count;
static TaskHandle_t running;
static TickType_t now;
static ucontext_t scheduler;

static void enter(void)
{
    running->code(running->parameters);
    abort(); /* a task must not return */
}

TaskHandle_t xTaskCreateStatic(TaskFunction_t code, const char *const name, const configSTACK_DEPTH_TYPE depth,
    void *const parameters, UBaseType_t priority, StackType_t *const stack, StaticTask_t *const buffer)
{
    const TaskHandle_t task = (TaskHandle_t)(void *)buffer;
    if ((name == NULL) || (stack == NULL) || (count == MOST) || (priority >= configMAX_PRIORITIES)) { return NULL; }
    memset(task, 0, sizeof *task);
    task->code = code;
    task->parameters = parameters;
    task->priority = priority;
    task->stack = (unsigned char *)stack;
    task->bytes = depth * sizeof *stack;
    memset(stack, PATTERN, task->bytes);
    (void)getcontext(&task->context);
    task->context.uc_stack.ss_sp = stack;
    task->context.uc_stack.ss_size = task->bytes;
    makecontext(&task->context, enter, 0);
    tasks[count++] = task;
    return task;
}

static void wait_until(TickType_t wakes)
{
    running->wakes = wakes;
    (void)swapcontext(&running->context, &scheduler);
}

BaseType_t xTaskDelayUntil(TickType_t *const previous, const TickType_t increment)
{
    *previous += increment;
    if (*previous <= now) { return pdFALSE; }
    wait_until(*previous);
    return pdTRUE;
}

void vTaskDelay(const TickType_t ticks) { wait_until(now + ticks); }

void vTaskSuspend(TaskHandle_t task)
{
    task = (task == NULL) ? running : task;
    task->suspended = 1;
    if (task == running) { (void)swapcontext(&running->context, &scheduler); }
}

TickType_t xTaskGetTickCount(void) { return now; }

UBaseType_t uxTaskGetStackHighWaterMark(TaskHandle_t task)
{
    size_t untouched = 0;
    while ((untouched < task->bytes) && (task->stack[untouched] == PATTERN)) { ++untouched; }
    return untouched / sizeof(StackType_t);
}

void stub_busy(TickType_t ticks) { now += ticks; }

void vTaskStartScheduler(void)
{
    for (;;) {
        TaskHandle_t next = NULL;
        TickType_t first = UINT32_MAX;
        for (int k = 0; k < count; ++k) {
            if (tasks[k]->suspended) { continue; }
            first = (tasks[k]->wakes < first) ? tasks[k]->wakes : first;
            if ((tasks[k]->wakes <= now) && ((next == NULL) || (tasks[k]->priority > next->priority))) { next = tasks[k]; }
        }
        if (next == NULL) {
            if (first == UINT32_MAX) { exit(9); } /* every task is suspended */
            now = first;
            continue;
        }
        running = next;
        (void)swapcontext(&scheduler, &next->context);
    }
}
