/* Saved states: flat copies of an instance's memory. */
#include "internal.h"

#include <stdlib.h>
#include <string.h>

static Status reject(Instance *c, const char *why)
{
    message_begin(&c->message, "the saved state is rejected: ");
    message_add(&c->message, why);
    return instance_report(c, ERROR, MISUSE);
}

static Status copy(Instance *c, const void *bytes, void **slot)
{
    if (!*slot)
        *slot = malloc(instance_memory_size());
    if (!*slot)
        return reject(c, "out of memory");
    memcpy(*slot, bytes, instance_memory_size());
    return OK;
}

Status instance_save(Instance *c, void **slot) { return copy(c, c->memory, slot); }

Status instance_restore(Instance *c, const void *saved)
{
    if (((const Memory *)saved)->identity != c->memory->identity)
        return reject(c,
                      "it was saved by another FMU, or by an instance of the other interface type");
    memcpy(c->memory, saved, instance_memory_size());
    return OK;
}

/* Returns the FNV-1a hash. This hash detects accidental damage, but not intentional changes. */
static uint64_t checksum(const unsigned char *bytes, size_t size)
{
    uint64_t sum = 14695981039346656037ULL;
    for (size_t i = 0; i < size; i++)
        sum = (sum ^ bytes[i]) * 1099511628211ULL;
    return sum;
}

size_t instance_serialized_size(void) { return instance_memory_size() + sizeof(uint64_t); }

Status instance_serialize(Instance *c, const void *saved, void *bytes, size_t size)
{
    if (size != instance_serialized_size())
        return reject(c, "its size is not the state size of this FMU");
    uint64_t sum = checksum(saved, instance_memory_size());
    memcpy(bytes, saved, instance_memory_size());
    memcpy((char *)bytes + instance_memory_size(), &sum, sizeof sum);
    return OK;
}

/* Returns why the saved state is rejected, or NULL. The bytes are untrusted input, even if their
   checksum is correct. A saved state that this runtime cannot have written is rejected. */
static const char *fault(const Instance *c, const Memory *m)
{
    int state = (int)m->state, both = INSTANTIATED | INITIALIZATION | TERMINATED;
    if (m->identity != c->memory->identity)
        return "it was saved by another FMU, or by an instance of the other interface type";
    if ((state & (state - 1)) != 0 ||
        !(state & (both | (c->model_exchange ? EVENT | CONTINUOUS : STEP))))
        return "its bytes are damaged";
    double limit = LARGEST_TIME * 1e9;
    if (!(fabs((double)m->start) <= limit && fabs((double)m->next_sample) <= 2 * limit &&
          fabs(m->clock) <= LARGEST_TIME))
        return "its bytes are damaged";
    for (int i = 0; i < block.values + block.states.count; i++) {
        const Value *value = &block.value[i < block.values ? i : 0];
        /* Some outputs and derivatives may be marked as not valid, for example after a failed
           evaluation. Such values are not used and need not be finite. */
        int stale = (inside((unsigned)i, block.outputs) &&
                     i >= block.outputs.first + computed_outputs(m)) ||
                    (inside((unsigned)i, block.derivatives) && !m->rates_valid);
        if ((!is_finite(m->value[i]) && !stale) ||
            (value->kind == BOOLEAN && m->value[i] != 0 && m->value[i] != 1) ||
            (value->kind == ENUMERATION && !(m->value[i] >= 1 && m->value[i] <= value->maximum)))
            return "its bytes are damaged";
    }
    return NULL;
}

Status instance_deserialize(Instance *c, const void *bytes, size_t size, void **slot)
{
    if (size != instance_serialized_size())
        return reject(c, "its size is not the state size of this FMU");
    uint64_t sum;
    memcpy(&sum, (const char *)bytes + instance_memory_size(), sizeof sum);
    if (sum != checksum(bytes, instance_memory_size()))
        return reject(c, "its bytes are damaged");
    /* The bytes are copied, because the caller's bytes may be unaligned. */
    void *copied = NULL;
    if (copy(c, bytes, &copied) != OK)
        return ERROR;
    const char *why = fault(c, copied);
    if (why) {
        free(copied);
        return reject(c, why);
    }
    free(*slot);
    *slot = copied;
    return OK;
}

void instance_free_saved(void **slot)
{
    free(*slot);
    *slot = NULL;
}
