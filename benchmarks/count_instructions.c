/* A plug-in of qemu's user mode: how many instructions a program executes (plug-in API version 1). */
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

typedef uint64_t Id;
struct Block;
extern void qemu_plugin_register_vcpu_tb_trans_cb(Id, void (*)(Id, struct Block *));
extern void qemu_plugin_register_vcpu_tb_exec_inline(struct Block *, int, void *, uint64_t);
extern size_t qemu_plugin_tb_n_insns(const struct Block *);
extern void qemu_plugin_register_atexit_cb(Id, void (*)(Id, void *), void *);
extern void qemu_plugin_outs(const char *);

int qemu_plugin_version = 1;
static uint64_t count;

static void translated(Id id, struct Block *block) {
    (void)id;
    qemu_plugin_register_vcpu_tb_exec_inline(block, 0 /* add */, &count, qemu_plugin_tb_n_insns(block));
}

static void ended(Id id, void *nothing) {
    char text[64];
    (void)id, (void)nothing;
    snprintf(text, sizeof text, "instructions %" PRIu64 "\n", count);
    qemu_plugin_outs(text);
}

int qemu_plugin_install(Id id, const void *info, int n, char **words) {
    (void)info, (void)n, (void)words;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, ended, NULL);
    return 0;
}
