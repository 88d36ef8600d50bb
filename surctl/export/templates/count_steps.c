/* QEMU plugin that counts the instructions of each step of the exported controller.
 *
 * A step begins where the processor reaches `from` and ends where it reaches `to`; the count of each step is one
 * line of the file `out`. The declarations are copied from QEMU's plugin interface, version 1.
 */
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void (*on_translation)(qemu_plugin_id_t, struct qemu_plugin_tb *);
typedef void (*on_execution)(unsigned int, void *);
typedef void (*on_exit)(qemu_plugin_id_t, void *);
extern void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, on_translation);
extern void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *, on_execution, int, void *);
extern void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, on_execution, int, void *);
extern void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, on_exit, void *);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;
__attribute__((visibility("default"))) int qemu_plugin_install(
    qemu_plugin_id_t id, const void *info, int argc, char **argv);

static uint64_t from, to; /* addresses */
static uint64_t done; /* instructions before the block that runs */
static uint64_t block; /* instructions of the block that runs */
static uint64_t began;
static bool inside;
static FILE *out;

static void enter(unsigned int cpu, void *size)
{
    (void)cpu;
    done += block;
    block = (uint64_t)(uintptr_t)size;
}

/* both addresses begin a block, because they are called */
static void begin(unsigned int cpu, void *nothing)
{
    (void)cpu;
    (void)nothing;
    began = done;
    inside = true;
}

static void end(unsigned int cpu, void *nothing)
{
    (void)cpu;
    (void)nothing;
    if (inside) {
        (void)fprintf(out, "%" PRIu64 "\n", done - began);
    }
    inside = false;
}

static void translate(qemu_plugin_id_t id, struct qemu_plugin_tb *tb)
{
    const uint64_t first = qemu_plugin_insn_vaddr(qemu_plugin_tb_get_insn(tb, 0));
    (void)id;
    qemu_plugin_register_vcpu_tb_exec_cb(tb, enter, 0, (void *)(uintptr_t)qemu_plugin_tb_n_insns(tb));
    if (first == from) {
        qemu_plugin_register_vcpu_insn_exec_cb(qemu_plugin_tb_get_insn(tb, 0), begin, 0, NULL);
    }
    if (first == to) {
        qemu_plugin_register_vcpu_insn_exec_cb(qemu_plugin_tb_get_insn(tb, 0), end, 0, NULL);
    }
}

static void leave(qemu_plugin_id_t id, void *nothing)
{
    (void)id;
    (void)nothing;
    (void)fclose(out);
}

int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int argc, char **argv)
{
    (void)info;
    for (int k = 0; k < argc; ++k) {
        if (strncmp(argv[k], "from=", 5) == 0) { from = strtoull(argv[k] + 5, NULL, 0); }
        if (strncmp(argv[k], "to=", 3) == 0) { to = strtoull(argv[k] + 3, NULL, 0); }
        if (strncmp(argv[k], "out=", 4) == 0) { out = fopen(argv[k] + 4, "w"); }
    }
    if (out == NULL) {
        return 1;
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    qemu_plugin_register_atexit_cb(id, leave, NULL);
    return 0;
}
