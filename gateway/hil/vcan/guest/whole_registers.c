/* A ptrace() for user-mode-linux on a host with AMX.
 *
 * UML 6.1 saves 2.7 KB of a guest process's vector registers. A host with AMX has 11 KB: it reads
 * any part of them, but sets only all of them (else EFAULT), and UML panics at its first process.
 * So this fills in the rest with the process's own values. UML traces from one thread: one buffer.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

typedef long call(enum __ptrace_request, pid_t, void *, void *);

long ptrace(enum __ptrace_request request, ...)
{
	static unsigned char registers[1 << 16];
	static call *kernel;
	va_list rest;
	va_start(rest, request);
	pid_t pid = va_arg(rest, pid_t);
	void *what = va_arg(rest, void *);
	void *data = va_arg(rest, void *);
	va_end(rest);

	if (!kernel)
		kernel = (call *)dlsym(RTLD_NEXT, "ptrace");
	if (request == PTRACE_SETREGSET && (unsigned long)what == NT_X86_XSTATE) {
		const struct iovec *part = data;
		struct iovec whole = {registers, sizeof registers};
		if (kernel(PTRACE_GETREGSET, pid, what, &whole) == 0 && part->iov_len < whole.iov_len) {
			memcpy(registers, part->iov_base, part->iov_len);
			return kernel(request, pid, what, &whole);
		}
	}
	return kernel(request, pid, what, data);
}
