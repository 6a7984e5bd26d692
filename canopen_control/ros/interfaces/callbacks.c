/* The functions of a made type support that rcl and rmw_fastrtps call: none of them runs Python.
 *
 * Fast DDS calls them while it holds mutexes of a writer, a reader or a participant. Python in such a call waits for the
 * GIL, which a thread may hold that waits for the same mutex inside rclpy: then the process stands still for ever. So
 * all that is called there is here, and what it needs are constants that Python wrote before.
 *
 * tools/native_callbacks makes callbacks_x86_64.so and callbacks_aarch64.so of this file, which need no other library.
 * The structures are those of rosidl_runtime_c, rosidl_typesupport_fastrtps_cpp and fastcdr of Jazzy; `abi.py` has
 * them for ctypes. A ROS message in C is a rosidl_runtime_c__String that holds the CDR body.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define EXPORT __attribute__((visibility("default")))
#define SLOTS 512 /* message types in a process; all that can be made are 230 */

enum { LITTLE_ENDIAN = 1 };       /* the second byte of a CDR header, the only kind that `cdr.py` decodes */
enum { NO_BOUND = 256 };          /* of the serialised size: Fast DDS grows the buffer */
enum { MAX_DEPTH = 64 };          /* of structures in structures; ROS's own are at most 7 deep */
enum kind { NUMBER, TEXT, NESTED };
enum shape { SCALAR, ARRAY, SEQUENCE }; /* a bounded sequence is a sequence on the wire */

struct string {
    char *data;
    size_t size, capacity;
};

/* What a field looks like on the wire: `size` is a number's, in bytes, `count` an array's length. */
struct field {
    uint8_t kind, shape, size;
    uint32_t count;
    const struct layout *nested;
};

struct layout {
    size_t count;
    const struct field *fields;
};

/* rosidl_message_type_support_t, and behind it what its functions return. */
struct message_support {
    const char *identifier;
    const void *data, *handle, *get_hash, *get_description, *get_sources;
    const void *hash, *description, *sources;
    const struct message_support *kinds[3];
};

/* rosidl_service_type_support_t, and the same. */
struct service_support {
    const char *identifier;
    const void *data, *handle, *request, *response, *event, *make_event, *remove_event;
    const void *get_hash, *get_description, *get_sources;
    const void *hash, *description, *sources;
    const struct service_support *kinds[3];
};

/* rosidl_action_type_support_t, and the same. */
struct action_support {
    const void *send_goal, *get_result, *cancel, *feedback, *status, *get_hash, *get_description, *get_sources;
    const void *hash, *description, *sources;
};

/* Functions of fastcdr and rosidl_runtime_c, the place of the end pointer in a Cdr, and the layouts: set by Python. */
EXPORT struct {
    void *(*put)(void *cdr, const char *data, size_t size); /* eprosima::fastcdr::Cdr::serialize_array */
    char *(*position)(void *cdr);                           /* eprosima::fastcdr::Cdr::get_current_position */
    bool (*assign)(struct string *into, const char *data, size_t size); /* rosidl_runtime_c__String__assignn */
    size_t end_offset;
    const struct layout *layouts[SLOTS];
} settings;

/* How many messages of each slot were dropped, since they have another layout; and of all. */
EXPORT uint32_t dropped[SLOTS];
EXPORT uint32_t dropped_in_all;

/* Of this file when the library was made: a test compares them. */
#ifdef SOURCE
EXPORT const char source[] = SOURCE;
#endif

static bool same(const char *one, const char *other) {
    while (*one && *one == *other) one++, other++;
    return *one == *other;
}

#define OF_KIND(name, support)                                             \
    EXPORT const void *name(const struct support *self, const char *kind) { \
        for (int each = 0; each < 3; each++)                                \
            if (self->kinds[each] && same(self->kinds[each]->identifier, kind)) return self->kinds[each]; \
        return NULL;                                                        \
    }
OF_KIND(message_of_kind, message_support)
OF_KIND(service_of_kind, service_support)

#define GETTERS(support)                                                                          \
    EXPORT const void *support##_hash(const struct support *self) { return self->hash; }          \
    EXPORT const void *support##_description(const struct support *self) { return self->description; } \
    EXPORT const void *support##_sources(const struct support *self) { return self->sources; }
GETTERS(message_support)
GETTERS(service_support)
GETTERS(action_support)

EXPORT bool serialize(const struct string *message, void *cdr) {
    if (message->size) settings.put(cdr, message->data, message->size);
    return true;
}

EXPORT uint32_t serialized_size(const struct string *message) { return (uint32_t)message->size; }

EXPORT size_t max_serialized_size(char *is_bounded) {
    *is_bounded = 0;
    return NO_BOUND;
}

/* Where a body is read: `at` and `end` are counted from its beginning. */
struct reader {
    const unsigned char *body;
    size_t at, end;
};

static bool pass(struct reader *in, size_t alignment, uint64_t length) {
    size_t at = (in->at + alignment - 1) & ~(alignment - 1);
    if (at > in->end || length > in->end - at) return false;
    in->at = at + (size_t)length;
    return true;
}

static bool pass_count(struct reader *in, uint32_t *count) {
    if (!pass(in, 4, 4)) return false;
    const unsigned char *four = in->body + in->at - 4;
    *count = four[0] | (uint32_t)four[1] << 8 | (uint32_t)four[2] << 16 | (uint32_t)four[3] << 24;
    return true;
}

static bool fits(struct reader *in, const struct layout *layout, int depth);

static bool field_fits(struct reader *in, const struct field *field, int depth) {
    uint32_t count = field->shape == ARRAY ? field->count : 1;
    if (field->shape == SEQUENCE && !pass_count(in, &count)) return false;
    if (count == 0) return true; /* the elements of an empty one are not aligned */
    if (field->kind == NUMBER) return pass(in, field->size, (uint64_t)count * field->size);
    if (count > in->end - in->at) return false; /* no element is smaller than a byte */
    for (; count; count--) {
        uint32_t length;
        if (field->kind == NESTED ? !fits(in, field->nested, depth - 1)
                                  : !pass_count(in, &length) || !pass(in, 1, length))
            return false;
    }
    return true;
}

/* Whether the body has that layout; what follows it is ignored. */
static bool fits(struct reader *in, const struct layout *layout, int depth) {
    if (depth == 0) return false;
    for (size_t each = 0; each < layout->count; each++)
        if (!field_fits(in, &layout->fields[each], depth)) return false;
    return true;
}

/* Takes what has come into a message; false, and Fast DDS drops it, if it is none of the slot's layout. */
static __attribute__((noinline)) bool deserialize(void *cdr, struct string *message, unsigned slot) {
    const char *start = settings.position(cdr);
    const char *end = *(const char *const *)((const char *)cdr + settings.end_offset);
    struct reader in = {(const unsigned char *)start, 0, (size_t)(end - start)};
    if (start[-3] == LITTLE_ENDIAN && fits(&in, settings.layouts[slot], MAX_DEPTH))
        return settings.assign(message, start, in.end);
    dropped[slot]++; /* several threads may count at once: it is told that there were some, not how many */
    dropped_in_all++;
    return false;
}

/* Fast DDS gives a function nothing to find its type by, so that each type has a function of its own. */
#define SLOT(number) static bool slot_##number(void *cdr, struct string *message) { return deserialize(cdr, message, 0##number); }
#define EIGHT(of, high) of(high##0) of(high##1) of(high##2) of(high##3) of(high##4) of(high##5) of(high##6) of(high##7)
#define NAMED(number) slot_##number,
#define ALL(of) \
    SIXTY_FOUR(of, 00) SIXTY_FOUR(of, 01) SIXTY_FOUR(of, 02) SIXTY_FOUR(of, 03) SIXTY_FOUR(of, 04) SIXTY_FOUR(of, 05) \
    SIXTY_FOUR(of, 06) SIXTY_FOUR(of, 07)
#define SIXTY_FOUR(of, high) \
    EIGHT(of, high##0) EIGHT(of, high##1) EIGHT(of, high##2) EIGHT(of, high##3) \
    EIGHT(of, high##4) EIGHT(of, high##5) EIGHT(of, high##6) EIGHT(of, high##7)

ALL(SLOT)

typedef bool (*deserializer)(void *cdr, struct string *message);
EXPORT deserializer slot(unsigned number) {
    static const deserializer slots[] = {ALL(NAMED)};
    return number < SLOTS ? slots[number] : NULL;
}
