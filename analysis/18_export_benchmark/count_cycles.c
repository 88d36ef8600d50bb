/* QEMU plugin that adds up, for each step and each part of a program, instructions and their costs.
 *
 * Options: from, to (addresses; a step begins at `from` and ends at `to`), rom (end of the last function), data (where
 * the memory for data begins; constants are below), table (a file with three bytes for each halfword up to `rom`: cost
 * of the instruction that begins there, its part, and what a branch that is not taken saves), steps (output: a line for each step, five numbers for each part), blocks (output: address, instructions and
 * executions of each translated block). A part of 255 is a library: it counts for the part that called it.
 * The declarations are copied from QEMU's plugin interface, version 1.
 */
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PARTS 4
#define LIBRARY 255u
#define LINE 16u /* bytes that the program memory delivers at once */

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void (*on_translation)(qemu_plugin_id_t, struct qemu_plugin_tb *);
typedef void (*on_execution)(unsigned int, void *);
typedef void (*on_access)(unsigned int, uint32_t, uint64_t, void *);
typedef void (*on_exit)(qemu_plugin_id_t, void *);
extern void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, on_translation);
extern void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *, on_execution, int, void *);
extern void qemu_plugin_register_vcpu_mem_cb(struct qemu_plugin_insn *, on_access, int, int, void *);
extern void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, on_exit, void *);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern size_t qemu_plugin_insn_size(const struct qemu_plugin_insn *);
extern uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;
__attribute__((visibility("default"))) int qemu_plugin_install(
    qemu_plugin_id_t id, const void *info, int argc, char **argv);

struct block {
    uint64_t first, end, instructions, cost, saved, lines, executions;
    unsigned part;
    struct block *before;
};

struct sums {
    uint64_t instructions, cost, lines, jumps, constants;
};

static uint64_t from, to, rom, data;
static uint8_t *table;
static struct block *blocks, *previous;
static struct sums sums[PARTS];
static unsigned part;
static bool inside;
static FILE *steps, *listed;

static void enter(unsigned int cpu, void *given)
{
    struct block *b = given;
    (void)cpu;
    if (b->first == to) {
        for (unsigned k = 0; inside && (k < PARTS); ++k) {
            (void)fprintf(steps, "%" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 "%s", sums[k].instructions,
                sums[k].cost, sums[k].lines, sums[k].jumps, sums[k].constants, (k + 1 < PARTS) ? " " : "\n");
        }
        inside = false;
    }
    if (b->first == from) {
        memset(sums, 0, sizeof sums);
        previous = NULL;
        inside = true;
    }
    if (inside) {
        const bool follows = (previous != NULL) && (previous->end == b->first);
        if (follows) { sums[part].cost -= previous->saved; }
        part = (b->part == LIBRARY) ? part : b->part;
        sums[part].instructions += b->instructions;
        sums[part].cost += b->cost;
        sums[part].lines += b->lines + ((!follows || (b->first % LINE == 0)) ? 1u : 0u);
        sums[part].jumps += follows ? 0u : 1u;
        previous = b;
        b->executions += 1;
    }
}

/* nothing is written to the program memory: an access to it reads a constant */
static void reading(unsigned int cpu, uint32_t what, uint64_t address, void *nothing)
{
    (void)cpu;
    (void)what;
    (void)nothing;
    if (inside && (address < data)) { sums[part].constants += 1; }
}

static void translate(qemu_plugin_id_t id, struct qemu_plugin_tb *tb)
{
    struct block *b = calloc(1, sizeof *b);
    (void)id;
    if (b == NULL) { abort(); }
    b->instructions = qemu_plugin_tb_n_insns(tb);
    b->first = qemu_plugin_insn_vaddr(qemu_plugin_tb_get_insn(tb, 0));
    b->part = (b->first < rom) ? table[b->first / 2 * 3 + 1] : PARTS - 1;
    b->before = blocks;
    blocks = b;
    for (uint64_t k = 0, last = b->first; k < b->instructions; ++k) {
        struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(tb, k);
        const uint64_t at = qemu_plugin_insn_vaddr(insn);
        b->lines += at / LINE - last / LINE;
        b->cost += (at < rom) ? table[at / 2 * 3] : 0;
        b->saved = (at < rom) ? table[at / 2 * 3 + 2] : 0;
        b->end = at + qemu_plugin_insn_size(insn);
        last = at;
        qemu_plugin_register_vcpu_mem_cb(insn, reading, 0, 3, NULL);
    }
    qemu_plugin_register_vcpu_tb_exec_cb(tb, enter, 0, b);
}

static void leave(qemu_plugin_id_t id, void *nothing)
{
    (void)id;
    (void)nothing;
    for (const struct block *b = blocks; b != NULL; b = b->before) {
        (void)fprintf(listed, "%" PRIu64 " %" PRIu64 " %" PRIu64 "\n", b->first, b->instructions, b->executions);
    }
    (void)fclose(steps);
    (void)fclose(listed);
}

int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int argc, char **argv)
{
    FILE *given = NULL;
    (void)info;
    for (int k = 0; k < argc; ++k) {
        if (strncmp(argv[k], "from=", 5) == 0) { from = strtoull(argv[k] + 5, NULL, 0); }
        if (strncmp(argv[k], "to=", 3) == 0) { to = strtoull(argv[k] + 3, NULL, 0); }
        if (strncmp(argv[k], "rom=", 4) == 0) { rom = strtoull(argv[k] + 4, NULL, 0); }
        if (strncmp(argv[k], "data=", 5) == 0) { data = strtoull(argv[k] + 5, NULL, 0); }
        if (strncmp(argv[k], "table=", 6) == 0) { given = fopen(argv[k] + 6, "rb"); }
        if (strncmp(argv[k], "steps=", 6) == 0) { steps = fopen(argv[k] + 6, "w"); }
        if (strncmp(argv[k], "blocks=", 7) == 0) { listed = fopen(argv[k] + 7, "w"); }
    }
    table = malloc(rom / 2 * 3 + 1);
    if ((given == NULL) || (steps == NULL) || (listed == NULL) || (table == NULL)
        || (fread(table, 1, rom / 2 * 3, given) != rom / 2 * 3)) {
        return 1;
    }
    (void)fclose(given);
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    qemu_plugin_register_atexit_cb(id, leave, NULL);
    return 0;
}
