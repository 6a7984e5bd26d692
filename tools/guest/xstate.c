/* Preloaded into user-mode Linux: sets the extended registers of a process as a whole.
 *
 * User-mode Linux saves and restores 2,696 bytes of extended registers. A kernel on a processor with AMX has more, and
 * since it takes them only as a whole, PTRACE_SETREGSET of fewer bytes fails with EFAULT (user-mode Linux 6.1 and 6.12).
 * What user-mode Linux does not save is left as it is: no process in the guest may use AMX.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

static long (*libc_ptrace)(int request, pid_t process, void *address, void *data);
static char registers[1 << 15]; /* not on the stack: that of user-mode Linux has 16 KiB */

__attribute__((constructor)) static void find(void)
{
    *(void **)&libc_ptrace = dlsym(RTLD_NEXT, "ptrace");
}

static long set_all(pid_t process, const struct iovec *part)
{
    struct iovec all = {registers, sizeof registers};
    long result = libc_ptrace(PTRACE_GETREGSET, process, (void *)NT_X86_XSTATE, &all);
    if (result == 0) {
        memcpy(registers, part->iov_base, part->iov_len < all.iov_len ? part->iov_len : all.iov_len);
        result = libc_ptrace(PTRACE_SETREGSET, process, (void *)NT_X86_XSTATE, &all);
    }
    return result;
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    pid_t process = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (request == PTRACE_SETREGSET && address == (void *)NT_X86_XSTATE)
        return set_all(process, data);
    return libc_ptrace(request, process, address, data);
}
