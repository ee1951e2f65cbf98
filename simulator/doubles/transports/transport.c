/* What every entry point shares: one connection a thread to the brain, packing and unpacking.
 *
 * This file and the functions generated behind it make one shared library. It knows nothing of boards or
 * tasks: it sends each call to the process at $SOLIMON_DOUBLES (host:port) and hands back the answer.
 *
 * Frames, little-endian: u32 length, then
 *   call:   u16 length and name, then the inputs in order;
 *   answer: i32 status, u32 length and text, then the outputs in order, each behind u8 "is there".
 * A text is u32 length and bytes; an array is u32 count and elements.
 *
 * One more connection, opened first and never used for calls, lives as long as the process: when it
 * closes, the brain knows that the process is gone.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#define STATUS_UNREACHABLE (-50401) /* PAL communications fault */
#define STATUS_ABORTED (-50405)     /* PAL transfer aborted */
#define STATUS_TEXT_TOO_LONG (-200228)
#define STATUS_ARRAY_TOO_LONG (-200234)
#define FRAME_LIMIT (1u << 30)
#define ERROR_ROOM 4096

static pthread_mutex_t gate = PTHREAD_MUTEX_INITIALIZER;
static pthread_once_t once = PTHREAD_ONCE_INIT;
static pthread_key_t closing;
/* Guarded by the gate. */
static int anchor = -1;
static uint64_t client;
static uint64_t generation;
static char address[256];

static __thread int line = -1;
static __thread uint64_t line_generation;
static __thread char error_text[ERROR_ROOM];

typedef void *TaskHandle;

struct message {
    unsigned char *bytes;
    size_t length, room, at;
    int broken; /* out of memory, or an answer shorter than it says */
};

static void close_with_thread(void *descriptor_plus_one) {
    close((int)((intptr_t)descriptor_plus_one - 1));
}

/* A forked child must not keep its parent's connections open: the parent's end would go unnoticed. */
static void forget_in_child(void) {
    pthread_mutex_t fresh = PTHREAD_MUTEX_INITIALIZER;
    gate = fresh;
    if (anchor >= 0) close(anchor);
    if (line >= 0) close(line);
    anchor = line = -1;
    pthread_setspecific(closing, NULL);
}

static void prepare(void) {
    pthread_key_create(&closing, close_with_thread);
    pthread_atfork(NULL, NULL, forget_in_child);
}

static int send_all(int descriptor, const void *from, size_t count) {
    const char *next = from;
    while (count > 0) {
        ssize_t sent = send(descriptor, next, count, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR) continue;
        if (sent <= 0) return -1;
        next += sent;
        count -= (size_t)sent;
    }
    return 0;
}

static int receive_all(int descriptor, void *into, size_t count) {
    char *next = into;
    while (count > 0) {
        ssize_t got = recv(descriptor, next, count, 0);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return -1;
        next += got;
        count -= (size_t)got;
    }
    return 0;
}

static int connect_to(const char *where) {
    char host[256];
    const char *colon = strrchr(where, ':');
    size_t length = colon ? (size_t)(colon - where) : 0;
    struct addrinfo hints, *found, *each;
    int descriptor = -1, at_once = 1;
    if (colon == NULL || length == 0 || length >= sizeof host) return -1;
    memcpy(host, where, length);
    host[length] = '\0';
    memset(&hints, 0, sizeof hints);
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host, colon + 1, &hints, &found) != 0) return -1;
    for (each = found; each != NULL && descriptor < 0; each = each->ai_next) {
        descriptor = socket(each->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
        if (descriptor >= 0 && connect(descriptor, each->ai_addr, each->ai_addrlen) != 0) {
            close(descriptor);
            descriptor = -1;
        }
    }
    freeaddrinfo(found);
    if (descriptor >= 0) setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &at_once, sizeof at_once);
    return descriptor;
}

/* Says who is calling: client 0 asks for a number, another one joins this connection to it. */
static int greet(int descriptor, uint64_t *number) {
    struct { uint32_t length; uint32_t process; uint64_t client; } __attribute__((packed)) hello;
    hello.length = sizeof hello - sizeof hello.length;
    hello.process = (uint32_t)getpid();
    hello.client = *number;
    if (send_all(descriptor, &hello, sizeof hello) != 0) return -1;
    return receive_all(descriptor, number, sizeof *number);
}

static int open_line(const char *where, uint64_t *number) {
    int descriptor = connect_to(where);
    if (descriptor >= 0 && greet(descriptor, number) != 0) {
        close(descriptor);
        descriptor = -1;
    }
    return descriptor;
}

static void drop_line(void) {
    if (line >= 0) close(line);
    line = -1;
    pthread_setspecific(closing, NULL);
}

/* 0 with a connection for this thread, or a status with its text. */
static int32_t reach_brain(void) {
    const char *where = getenv("SOLIMON_DOUBLES");
    uint64_t number, now;
    pthread_once(&once, prepare);
    if (where == NULL || *where == '\0' || strlen(where) >= sizeof address) {
        snprintf(error_text, sizeof error_text,
                 "SOLIMON_DOUBLES is not set: this libnidaqmx is a double for tests and needs host:port of a "
                 "running 'python -m simulator.doubles'. Remove its folder from LD_LIBRARY_PATH to use "
                 "NI-DAQmx itself.");
        return STATUS_UNREACHABLE;
    }
    pthread_mutex_lock(&gate);
    if (anchor >= 0 && strcmp(address, where) != 0) {
        close(anchor);
        anchor = -1;
    }
    if (anchor < 0) {
        client = 0;
        strcpy(address, where);
        anchor = open_line(where, &client);
        generation++;
    }
    now = generation;
    number = client;
    pthread_mutex_unlock(&gate);
    if (line >= 0 && line_generation != now) drop_line();
    if (line < 0 && anchor >= 0) {
        line = open_line(where, &number);
        line_generation = now;
        if (line >= 0) pthread_setspecific(closing, (void *)((intptr_t)line + 1));
    }
    if (line < 0) {
        snprintf(error_text, sizeof error_text,
                 "No NI-DAQmx double answers at %s; start it again and set SOLIMON_DOUBLES.", where);
        return STATUS_UNREACHABLE;
    }
    return 0;
}

static void lose_brain(void) {
    pthread_mutex_lock(&gate);
    if (line_generation == generation && anchor >= 0) {
        close(anchor);
        anchor = -1;
    }
    pthread_mutex_unlock(&gate);
    drop_line();
    snprintf(error_text, sizeof error_text,
             "The NI-DAQmx double at %s went away during the call; its boards are gone with it.", address);
}

static void put(struct message *call, const void *from, size_t count) {
    if (call->broken) return;
    if (call->length + count > call->room) {
        size_t room = 2 * (call->length + count) + 256;
        unsigned char *bytes = realloc(call->bytes, room);
        if (bytes == NULL) {
            call->broken = 1;
            return;
        }
        call->bytes = bytes;
        call->room = room;
    }
    if (count > 0) memcpy(call->bytes + call->length, from, count);
    call->length += count;
}

static void put_text(struct message *call, const char *text) {
    uint32_t length = text == NULL ? 0 : (uint32_t)strlen(text);
    put(call, &length, sizeof length);
    if (length > 0) put(call, text, length);
}

static void put_array(struct message *call, const void *from, uint32_t count, size_t width) {
    if (from == NULL) count = 0;
    put(call, &count, sizeof count);
    put(call, from, count * width);
}

static void begin(struct message *call, const char *name) {
    uint32_t length = 0;
    uint16_t name_length = (uint16_t)strlen(name);
    memset(call, 0, sizeof *call);
    put(call, &length, sizeof length);
    put(call, &name_length, sizeof name_length);
    put(call, name, name_length);
}

/* The next bytes of the answer, or NULL if it ends before. */
static const unsigned char *next(struct message *answer, size_t count) {
    const unsigned char *here = answer->bytes + answer->at;
    if (answer->broken || answer->length - answer->at < count) {
        answer->broken = 1;
        return NULL;
    }
    answer->at += count;
    return here;
}

static uint32_t next_count(struct message *answer) {
    uint32_t count = 0;
    const unsigned char *here = next(answer, sizeof count);
    if (here != NULL) memcpy(&count, here, sizeof count);
    return count;
}

/* Sends the call, reads the answer into the same message, and keeps its text for this thread. */
static int32_t exchange(struct message *message) {
    uint32_t length;
    int32_t status = reach_brain();
    const unsigned char *here;
    size_t shown;
    if (status != 0) {
        message->broken = 1;
        return status;
    }
    length = (uint32_t)(message->length - sizeof length);
    if (!message->broken) memcpy(message->bytes, &length, sizeof length);
    if (message->broken || send_all(line, message->bytes, message->length) != 0
        || receive_all(line, &length, sizeof length) != 0 || length > FRAME_LIMIT) {
        message->broken = 1;
        lose_brain();
        return STATUS_ABORTED;
    }
    message->length = message->at = 0;
    if (length > message->room) {
        unsigned char *bytes = realloc(message->bytes, length);
        if (bytes == NULL) message->broken = 1;
        else message->bytes = bytes, message->room = length;
    }
    if (message->broken || receive_all(line, message->bytes, length) != 0) {
        message->broken = 1;
        lose_brain();
        return STATUS_ABORTED;
    }
    message->length = length;
    here = next(message, sizeof status);
    if (here != NULL) memcpy(&status, here, sizeof status);
    length = next_count(message);
    here = next(message, length);
    if (here != NULL && status != 0) {
        shown = length < ERROR_ROOM - 1 ? length : ERROR_ROOM - 1;
        memcpy(error_text, here, shown);
        error_text[shown] = '\0';
    }
    return status;
}

static int is_there(struct message *answer) {
    const unsigned char *here = next(answer, 1);
    return here != NULL && *here != 0;
}

static void take(struct message *answer, void *into, size_t width) {
    const unsigned char *here;
    if (!is_there(answer)) return;
    here = next(answer, width);
    if (here != NULL && into != NULL) memcpy(into, here, width);
}

/* Copies what has room; returns how many there are. */
static uint32_t take_array(struct message *answer, void *into, uint32_t room, size_t width) {
    uint32_t count;
    const unsigned char *here;
    if (!is_there(answer)) return 0;
    count = next_count(answer);
    here = next(answer, count * width);
    if (here != NULL && into != NULL) memcpy(into, here, (count < room ? count : room) * width);
    return count;
}

/* NI's convention for text: no room asks for the room needed; too little is an error. */
static int32_t fill_text(int32_t status, const char *text, size_t length, char *into, uint32_t room) {
    if (status < 0) return status;
    if (room == 0 || into == NULL) return (int32_t)length + 1;
    if (length >= room) {
        memcpy(into, text, room - 1);
        into[room - 1] = '\0';
        snprintf(error_text, sizeof error_text, "The text needs %zu bytes, the buffer has %u.", length + 1,
                 room);
        return STATUS_TEXT_TOO_LONG;
    }
    memcpy(into, text, length);
    into[length] = '\0';
    return status;
}

/* Not sent to the brain: the library keeps the last error of each thread, as NI's. */
int32_t DAQmxGetExtendedErrorInfo(char *error_string, uint32_t buffer_size) {
    return fill_text(0, error_text, strlen(error_text), error_string, buffer_size);
}

static int32_t take_text(struct message *answer, int32_t status, char *into, uint32_t room) {
    uint32_t length;
    const unsigned char *here;
    if (!is_there(answer)) return status;
    length = next_count(answer);
    here = next(answer, length);
    return fill_text(status, here == NULL ? "" : (const char *)here, here == NULL ? 0 : length, into, room);
}

/* NI's convention for arrays behind an attribute: no room asks for the count. */
static int32_t take_sized_array(struct message *answer, int32_t status, void *into, uint32_t room,
                                size_t width) {
    uint32_t count = take_array(answer, room == 0 ? NULL : into, room, width);
    if (status < 0) return status;
    if (room == 0 || into == NULL) return (int32_t)count;
    if (count > room) {
        snprintf(error_text, sizeof error_text, "The array has %u elements, the buffer room for %u.", count,
                 room);
        return STATUS_ARRAY_TOO_LONG;
    }
    return status;
}

/* `kind`: width of a number in bytes, 0 text, -width an array, 100 floating point; 99 unknown. */
#define KIND_TEXT 0
#define KIND_UNKNOWN 99
#define KIND_FLOAT64 100

static int attribute_kind(int32_t attribute);

static int32_t take_attribute(struct message *answer, int32_t status, int32_t attribute, va_list tail) {
    int kind = attribute_kind(attribute);
    void *into = kind == KIND_UNKNOWN ? NULL : va_arg(tail, void *);
    if (kind == KIND_UNKNOWN) return status;
    if (kind == KIND_TEXT) return take_text(answer, status, into, va_arg(tail, uint32_t));
    if (kind < 0) return take_sized_array(answer, status, into, va_arg(tail, uint32_t), (size_t)-kind);
    take(answer, into, kind == KIND_FLOAT64 ? 8 : (size_t)kind);
    return status;
}

static void put_attribute(struct message *call, int32_t attribute, va_list tail) {
    int kind = attribute_kind(attribute);
    if (kind == KIND_TEXT) {
        put_text(call, va_arg(tail, const char *));
    } else if (kind == KIND_FLOAT64) {
        double number = va_arg(tail, double);
        put(call, &number, sizeof number);
    } else if (kind == 8) {
        uint64_t number = va_arg(tail, uint64_t);
        put(call, &number, sizeof number);
    } else if (kind > 0 && kind != KIND_UNKNOWN) {
        uint32_t number = va_arg(tail, uint32_t);
        put(call, &number, sizeof number);
    } else if (kind < 0) {
        const void *from = va_arg(tail, const void *);
        uint32_t count = va_arg(tail, uint32_t);
        put_array(call, from, count, (size_t)-kind);
    }
}

/* Pairs of name and state (or place for a state) up to NULL: names go as one text with line feeds. */
static void put_states(struct message *call, va_list tail, int with_values) {
    struct message names = {0}, states = {0};
    uint32_t count = 0, length;
    const char *name;
    while ((name = va_arg(tail, const char *)) != NULL) {
        if (count > 0) put(&names, "\n", 1);
        put(&names, name, strlen(name));
        if (with_values) {
            int32_t state = va_arg(tail, int32_t);
            put(&states, &state, sizeof state);
        } else {
            (void)va_arg(tail, int32_t *);
        }
        count++;
    }
    length = (uint32_t)names.length;
    put(call, &length, sizeof length);
    put(call, names.bytes, names.length);
    if (with_values) put_array(call, states.bytes == NULL ? (unsigned char *)"" : states.bytes, count, 4);
    free(names.bytes);
    free(states.bytes);
}

static void take_states(struct message *answer, va_list tail) {
    uint32_t count = is_there(answer) ? next_count(answer) : 0;
    while (count-- > 0 && va_arg(tail, const char *) != NULL) {
        int32_t *into = va_arg(tail, int32_t *);
        const unsigned char *here = next(answer, sizeof *into);
        if (here != NULL && into != NULL) memcpy(into, here, sizeof *into);
    }
}
