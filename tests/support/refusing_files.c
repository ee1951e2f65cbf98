/* A file system that refuses, for any program: LD_PRELOAD it. What it refuses stands in the environment.

   REFUSE_UNDER  files whose path begins so
   REFUSE_FILES  of these only those whose further path is such a pattern, for example "/sets/set_?.h5"
   REFUSE_CALLS  which calls, for example "open,rename,unlink"
   REFUSE_ERRNO  what they answer
   REFUSE_WHEN   "first MS": each call on each file, for so long from its first time on
                 "rate N": N of a thousand, by chance; "file": while the file REFUSE_WHILE is there
                 "from N COUNT": so many calls from the Nth one on, counted from 0; of COUNT 0 all are noted
   REFUSE_LOG    where each refusal is noted */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>
#include <sys/uio.h>
#include <unistd.h>

enum { SEEN_MAX = 4096, PATH_LENGTH = 512 };

static struct { char name[PATH_LENGTH]; double since_s; } seen[SEEN_MAX];
static int seen_count;
static unsigned seed;
static long call_count, refusal_count;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define NEXT(name) \
    static __typeof__(&name) next; \
    if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int real_open(const char *path, int flags) {
    static int (*next)(const char *, int, ...);
    if (!next) next = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open64");
    return next(path, flags, 0644);
}

static double now_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int is_first(const char *call, const char *path, double for_s) {
    char name[PATH_LENGTH];
    snprintf(name, sizeof name, "%s %s", call, path);
    for (int i = 0; i < seen_count; i++)
        if (!strcmp(seen[i].name, name)) return now_s() < seen[i].since_s + for_s;
    if (seen_count == SEEN_MAX) return 0;
    strcpy(seen[seen_count].name, name);
    seen[seen_count++].since_s = now_s();
    return 1;
}

long refusals(void) { return refusal_count; }

static int is_called(const char *call, const char *calls) {
    const char *found = strstr(calls, call);
    return found && strchr(",", found[strlen(call)]) && (found == calls || found[-1] == ',');
}

static int refused(const char *call, const char *path) {
    const char *under = getenv("REFUSE_UNDER"), *calls = getenv("REFUSE_CALLS"), *when = getenv("REFUSE_WHEN");
    if (!under || !calls || !when || !path || strncmp(path, under, strlen(under)) || !is_called(call, calls)) return 0;
    const char *files = getenv("REFUSE_FILES");
    if (files && fnmatch(files, path + strlen(under), 0)) return 0;
    int yes = 0, kept = errno;
    pthread_mutex_lock(&lock);
    if (!strncmp(when, "first ", 6)) yes = is_first(call, path, atof(when + 6) / 1e3);
    if (!strncmp(when, "rate ", 5)) {
        if (!seed) seed = (unsigned)getpid();
        yes = rand_r(&seed) % 1000 < atoi(when + 5);
    }
    long first, count;
    int noted_only = 0;
    if (sscanf(when, "from %ld %ld", &first, &count) == 2) {
        yes = call_count >= first && call_count - first < count;
        noted_only = !count;
        call_count++;
    }
    if (!strcmp(when, "file")) yes = !access(getenv("REFUSE_WHILE"), F_OK);
    const char *noted = getenv("REFUSE_LOG");
    refusal_count += yes;
    if ((yes || noted_only) && noted) {
        char line[PATH_LENGTH];
        int length = snprintf(line, sizeof line, "%s %s\n", call, path), log = real_open(noted, O_WRONLY | O_CREAT | O_APPEND);
        if (log >= 0 && write(log, line, (size_t)length) >= 0) close(log);
    }
    pthread_mutex_unlock(&lock);
    errno = yes ? atoi(getenv("REFUSE_ERRNO")) : kept;
    return yes;
}

static int refused_descriptor(const char *call, int descriptor) {
    char link[64], path[PATH_LENGTH];
    if (!getenv("REFUSE_CALLS") || !is_called(call, getenv("REFUSE_CALLS"))) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return refused(call, path);
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        static int (*next)(const char *, int, ...); \
        if (!next) next = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name); \
        return refused("open", path) ? -1 : next(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

int rename(const char *from, const char *to) { NEXT(rename); return refused("rename", to) ? -1 : next(from, to); }
int unlink(const char *path) { NEXT(unlink); return refused("unlink", path) ? -1 : next(path); }
int mkdir(const char *path, mode_t mode) { NEXT(mkdir); return refused("mkdir", path) ? -1 : next(path, mode); }
ssize_t write(int d, const void *p, size_t n) { NEXT(write); return refused_descriptor("write", d) ? -1 : next(d, p, n); }
ssize_t writev(int d, const struct iovec *p, int n) { NEXT(writev); return refused_descriptor("write", d) ? -1 : next(d, p, n); }
ssize_t pwrite64(int d, const void *p, size_t n, off64_t o) { NEXT(pwrite64); return refused_descriptor("write", d) ? -1 : next(d, p, n, o); }
ssize_t read(int d, void *p, size_t n) { NEXT(read); return refused_descriptor("read", d) ? -1 : next(d, p, n); }
int fsync(int d) { NEXT(fsync); return refused_descriptor("fsync", d) ? -1 : next(d); }
int fdatasync(int d) { NEXT(fdatasync); return refused_descriptor("fsync", d) ? -1 : next(d); }
ssize_t pwrite(int d, const void *p, size_t n, off_t o) { NEXT(pwrite); return refused_descriptor("write", d) ? -1 : next(d, p, n, o); }
int rmdir(const char *path) { NEXT(rmdir); return refused("unlink", path) ? -1 : next(path); }
int posix_fallocate(int d, off_t o, off_t n) { NEXT(posix_fallocate); return refused_descriptor("allocate", d) ? errno : next(d, o, n); }
int posix_fallocate64(int d, off64_t o, off64_t n) { NEXT(posix_fallocate64); return refused_descriptor("allocate", d) ? errno : next(d, o, n); }
int ftruncate(int d, off_t n) { NEXT(ftruncate); return refused_descriptor("truncate", d) ? -1 : next(d, n); }
int ftruncate64(int d, off64_t n) { NEXT(ftruncate64); return refused_descriptor("truncate", d) ? -1 : next(d, n); }
