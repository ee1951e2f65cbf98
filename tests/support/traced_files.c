/* Writes down every call that changes a file under a folder, in order, for any program: LD_PRELOAD it.

   TRACE_UNDER  a folder: itself and all below it
   TRACE_TO     where the calls go, each after it has succeeded and before its caller knows: what one process
                does because another one has done something stands behind it

   A call is a head (struct head, little-endian), its path, and what it wrote or the path that it renamed to. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { PATH_LENGTH = 512 };

struct __attribute__((packed)) head { char call; uint32_t path_length, content_length; int64_t number; };

#define NEXT(name) \
    static __typeof__(&name) next; \
    if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int is_traced(const char *path) {
    const char *under = getenv("TRACE_UNDER");
    if (!under || !path || strncmp(path, under, strlen(under))) return 0;
    return strchr("/", path[strlen(under)]) != NULL;
}

static void put(char call, const char *path, int64_t number, const struct iovec *content, int n) {
    static int (*next_open)(const char *, int, ...);
    static ssize_t (*next_writev)(int, const struct iovec *, int);
    if (!next_open) next_open = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open64");
    if (!next_writev) next_writev = (ssize_t (*)(int, const struct iovec *, int))dlsym(RTLD_NEXT, "writev");
    int kept = errno;
    struct iovec all[n + 2];
    struct head head = {call, (uint32_t)strlen(path), 0, number};
    size_t whole = sizeof head + head.path_length;
    for (int i = 0; i < n; i++) head.content_length += (uint32_t)(all[i + 2] = content[i]).iov_len;
    all[0] = (struct iovec){&head, sizeof head};
    all[1] = (struct iovec){(void *)path, head.path_length};
    int trace = next_open(getenv("TRACE_TO"), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    if (trace < 0 || next_writev(trace, all, n + 2) != (ssize_t)(whole + head.content_length)) abort();
    close(trace);
    errno = kept;
}

static int path_of(int descriptor, char *path) {
    char link[64];
    int kept = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = getenv("TRACE_UNDER") ? readlink(link, path, PATH_LENGTH - 1) : -1;
    errno = kept;
    if (length < 0) return 0;
    path[length] = 0;
    return is_traced(path);
}

static void put_descriptor(char call, int descriptor, int64_t number) {
    char path[PATH_LENGTH];
    if (path_of(descriptor, path)) put(call, path, number, NULL, 0);
}

static void put_written(int descriptor, const struct iovec *parts, int n, ssize_t done, off64_t offset) {
    char path[PATH_LENGTH];
    if (done <= 0 || !path_of(descriptor, path)) return;
    if (offset < 0) offset = lseek64(descriptor, 0, SEEK_CUR) - done;
    struct iovec taken[n];
    ssize_t left = done;
    for (int i = 0; i < n; i++) {
        taken[i] = parts[i];
        if ((ssize_t)taken[i].iov_len > left) taken[i].iov_len = (size_t)left;
        left -= (ssize_t)taken[i].iov_len;
    }
    put('w', path, offset, taken, n);
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        static int (*next)(const char *, int, ...); \
        if (!next) next = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name); \
        int d = next(path, flags, mode); \
        if (d >= 0 && flags & (O_CREAT | O_TRUNC) && is_traced(path)) put('o', path, !!(flags & O_TRUNC), NULL, 0); \
        return d; \
    }
OPEN(open)
OPEN(open64)

#define TWO_PATHS(name, call) \
    int name(const char *from, const char *to) { \
        NEXT(name); \
        int failed = next(from, to); \
        if (!failed && is_traced(from)) put(call, from, 0, &(struct iovec){(void *)to, strlen(to)}, 1); \
        return failed; \
    }
TWO_PATHS(rename, 'r')
TWO_PATHS(link, 'l')

#define ONE_PATH(name, call, parameters, arguments) \
    int name parameters { \
        NEXT(name); \
        int failed = next arguments; \
        if (!failed && is_traced(path)) put(call, path, 0, NULL, 0); \
        return failed; \
    }
ONE_PATH(unlink, 'u', (const char *path), (path))
ONE_PATH(rmdir, 'u', (const char *path), (path))
ONE_PATH(mkdir, 'm', (const char *path, mode_t mode), (path, mode))

#define DESCRIPTOR(name, call, number, parameters, arguments) \
    int name parameters { \
        NEXT(name); \
        int failed = next arguments; \
        if (!failed) put_descriptor(call, d, number); \
        return failed; \
    }
DESCRIPTOR(fsync, 's', 0, (int d), (d))
DESCRIPTOR(fdatasync, 's', 0, (int d), (d))
DESCRIPTOR(ftruncate, 't', n, (int d, off_t n), (d, n))
DESCRIPTOR(ftruncate64, 't', n, (int d, off64_t n), (d, n))
DESCRIPTOR(posix_fallocate, 'a', from + n, (int d, off_t from, off_t n), (d, from, n))
DESCRIPTOR(posix_fallocate64, 'a', from + n, (int d, off64_t from, off64_t n), (d, from, n))

ssize_t write(int d, const void *p, size_t n) {
    NEXT(write);
    ssize_t done = next(d, p, n);
    put_written(d, &(struct iovec){(void *)p, n}, 1, done, -1);
    return done;
}

ssize_t writev(int d, const struct iovec *p, int n) {
    NEXT(writev);
    ssize_t done = next(d, p, n);
    put_written(d, p, n, done, -1);
    return done;
}

#define PWRITE(name, type) \
    ssize_t name(int d, const void *p, size_t n, type offset) { \
        NEXT(name); \
        ssize_t done = next(d, p, n, offset); \
        put_written(d, &(struct iovec){(void *)p, n}, 1, done, offset); \
        return done; \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define MMAP(name, type) \
    void *name(void *at, size_t n, int protection, int flags, int d, type offset) { \
        NEXT(name); \
        void *mapped = next(at, n, protection, flags, d, offset); \
        if (d >= 0 && mapped != MAP_FAILED && protection & PROT_WRITE && flags & MAP_SHARED) put_descriptor('p', d, 0); \
        return mapped; \
    }
MMAP(mmap, off_t)
MMAP(mmap64, off64_t)
