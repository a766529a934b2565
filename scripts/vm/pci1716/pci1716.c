/*
 * Advantech PCI-1716 and PCI-1711 at register level, for QEMU 7.2.
 *
 * docs/reference/emulated-board.md says what is modelled, from which source, and what is not. The voltages at the
 * plugs come from the properties ai0..ai15, or from a bench outside the machine while the property "coupled" is true
 * (see bench_exchange).
 *
 * SPDX-License-Identifier: BSD-3-Clause
 */
#include "qemu/osdep.h"
#include <math.h>
#include "qemu/error-report.h"
#include "qemu/module.h"
#include "qemu/timer.h"
#include "qapi/error.h"
#include "qapi/visitor.h"
#include "chardev/char-fe.h"
#include "hw/pci/pci.h"
#include "hw/qdev-properties.h"
#include "hw/qdev-properties-system.h"

#define TYPE_FAMILY "pci171x"
OBJECT_DECLARE_TYPE(Board, BoardClass, FAMILY)

enum { INPUTS = 16, OUTPUTS = 2, FIFO = 1024, COUNTERS = 3, DIGITAL_WRITES = 128 };

/* Offsets in the I/O window; reading and writing differ. */
enum {
    AD_DATA = 0, SOFT_TRIGGER = 0, RANGE = 2, MUX = 4, STATUS = 6, CONTROL = 6, CLEAR_INTERRUPT = 8, CLEAR_FIFO = 9,
    DA0 = 10, DA1 = 12, DA_REFERENCE = 14, DIGITAL = 16, BOARD_ID = 20, COUNTER0 = 24, COUNTER_CONTROL = 30,
    WINDOW = 32,
};

enum { BY_SOFTWARE = 1 << 0, BY_PACER = 1 << 1, INTERRUPT_ENABLED = 1 << 4, AT_HALF_FULL = 1 << 5 };
enum { EMPTY = 1 << 8, HALF_FULL = 1 << 9, FULL = 1 << 10, INTERRUPT = 1 << 11 };
enum { UNIPOLAR = 1 << 4, DIFFERENTIAL = 1 << 5 };

#define PACER_TICK_NS 100   /* 10 MHz */
#define ACCESS_NS 1000      /* what a read over the PCI bus takes, where the machine's clock counts instructions */
#define OPEN_INPUT_KEEPS 0.9 /* part of the neighbour's voltage that an open input shows */

typedef struct {
    double low, high;
} Span;

struct BoardClass {
    PCIDeviceClass parent_class;
    unsigned bits;
    int64_t conversion_ns;
    const Span *bipolar;        /* by gain code */
    const Span *outputs;        /* by reference code */
    unsigned reference_bits;    /* between the codes of two outputs */
    uint16_t reference_mask;
    bool tagged;                /* a sample carries its channel's number */
};

typedef struct {
    uint8_t mode, latched;
    bool high_next, loaded;
    uint16_t divisor;
    int64_t since_ns;
} Counter;

typedef struct {
    uint64_t t_ns;
    uint16_t value;
} DigitalWrite;

struct Board {
    PCIDevice parent_obj;
    MemoryRegion window;
    CharBackend bench;
    QEMUTimer *pacer, *watch, *storm_end;
    uint32_t bench_period_us;

    uint16_t control, mux, reference, digital_out, digital_in, contacts;
    uint8_t channel, ranges[INPUTS];
    uint16_t fifo[FIFO], last;
    unsigned first, count;
    bool interrupt;
    Counter counters[COUNTERS];
    int64_t next_ns, started_ns, accesses;
    bool converting;

    uint16_t codes[OUTPUTS];
    double inputs_v[INPUTS], outputs_v[OUTPUTS], on_multiplexer_v;
    int64_t exchanged_ns;
    uint64_t outputs_changed_ns, digital_written_ns, contacts_changed_ns;
    DigitalWrite digital_writes[DIGITAL_WRITES];
    unsigned digital_count;

    bool coupled, hung, irq_lost, irq_stuck, storm;
    uint32_t open_inputs;
    uint64_t overruns, conversions;
};

/* What the board sends at the given time of the guest, and what comes back; little-endian, as this machine is. */
typedef struct QEMU_PACKED {
    int64_t t_ns;
    double outputs_v[OUTPUTS];
    uint16_t digital_out, unused[3];
} ToBench;

typedef struct QEMU_PACKED {
    double inputs_v[INPUTS];
    uint16_t digital_in, unused[3];
} FromBench;

static const Span bipolar_1716[] = {{-5, 5}, {-2.5, 2.5}, {-1.25, 1.25}, {-0.625, 0.625}, {-10, 10}};
static const Span bipolar_1711[] = {{-10, 10}, {-5, 5}, {-2.5, 2.5}, {-1.25, 1.25}, {-0.625, 0.625}};
static const Span unipolar_1716[] = {{0, 10}, {0, 5}, {0, 2.5}, {0, 1.25}, {0, 0}};
/* Codes of an external reference give 0 V: none is connected. */
static const Span outputs_1716[] = {{-5, 5}, {-10, 10}, {0, 5}, {0, 10}, {0, 0}, {0, 0}, {0, 0}, {0, 0}};
static const Span outputs_1711[] = {{0, 5}, {0, 10}, {0, 0}, {0, 0}};

static int64_t now_ns(void)
{
    return qemu_clock_get_ns(QEMU_CLOCK_VIRTUAL);
}

/* Hand the outputs to the bench and take its inputs, both at one time. The guest waits; its clock does not. */
static void bench_exchange(Board *b, int64_t t_ns)
{
    ToBench to = {.t_ns = t_ns, .outputs_v = {b->outputs_v[0], b->outputs_v[1]}, .digital_out = b->digital_out};
    FromBench from;

    b->exchanged_ns = t_ns;
    if (!b->coupled) {
        return;
    }
    if (qemu_chr_fe_write_all(&b->bench, (uint8_t *)&to, sizeof(to)) != sizeof(to) ||
        qemu_chr_fe_read_all(&b->bench, (uint8_t *)&from, sizeof(from)) != sizeof(from)) {
        error_report("pci1716: the bench has gone");
        exit(1);
    }
    memcpy(b->inputs_v, from.inputs_v, sizeof(b->inputs_v));
    b->digital_in = from.digital_in;
}

static void bench_watch(void *opaque)
{
    Board *b = opaque;
    int64_t t_ns = now_ns(), period_ns = b->bench_period_us * 1000LL;

    if (t_ns - b->exchanged_ns >= period_ns) {
        bench_exchange(b, t_ns);
    }
    timer_mod(b->watch, b->exchanged_ns + period_ns);
}

static void update_interrupt(Board *b)
{
    pci_set_irq(PCI_DEVICE(b), b->irq_stuck || ((b->interrupt || b->storm) && !b->irq_lost));
}

static void update_outputs(Board *b)
{
    BoardClass *k = FAMILY_GET_CLASS(b);
    unsigned steps = (1u << k->bits) - 1;
    double before[OUTPUTS] = {b->outputs_v[0], b->outputs_v[1]};

    for (int i = 0; i < OUTPUTS; i++) {
        const Span *span = &k->outputs[(b->reference >> (i * k->reference_bits)) & k->reference_mask];
        unsigned code = b->codes[i] & steps;

        b->outputs_v[i] = span->low < 0 ? span->high * ((double)code / (1u << (k->bits - 1)) - 1)
                                        : span->high * code / steps;
    }
    if (memcmp(before, b->outputs_v, sizeof(before))) {
        b->outputs_changed_ns = now_ns();
        bench_exchange(b, now_ns());
    }
}

static uint16_t code_of(BoardClass *k, uint8_t range, double volts)
{
    unsigned gain = MIN(range & 7, ARRAY_SIZE(bipolar_1716) - 1);
    bool unipolar = (range & UNIPOLAR) && !k->tagged;
    const Span *span = unipolar ? &unipolar_1716[gain] : &k->bipolar[gain];
    double steps = (1u << k->bits) - 1;
    double code = unipolar ? volts / span->high * steps : (volts / span->high + 1) * (1u << (k->bits - 1));

    return MAX(0, MIN(steps, floor(code + 0.5)));
}

static double voltage_at(Board *b, unsigned channel)
{
    double volts = b->inputs_v[channel];

    if (b->ranges[channel] & DIFFERENTIAL) {
        volts -= b->inputs_v[channel | 1];
    }
    if (b->open_inputs & (1u << channel)) {
        volts = OPEN_INPUT_KEEPS * b->on_multiplexer_v;
    }
    b->on_multiplexer_v = volts;
    return volts;
}

/* One conversion: the sample goes to the FIFO, the multiplexer to the next channel of its interval. */
static void convert(Board *b, int64_t t_ns)
{
    BoardClass *k = FAMILY_GET_CLASS(b);
    unsigned channel = b->channel;
    uint16_t sample;

    if (t_ns - b->exchanged_ns >= b->bench_period_us * 1000LL) {
        bench_exchange(b, t_ns);
    }
    sample = code_of(k, b->ranges[channel], voltage_at(b, channel)) | (k->tagged ? channel << 12 : 0);
    b->conversions++;
    if (b->count < FIFO) {
        b->fifo[(b->first + b->count++) % FIFO] = sample;
    } else {
        b->overruns++;
    }
    if (channel == ((b->mux >> 8) & 15) || (b->ranges[channel] & DIFFERENTIAL && (channel | 1) == ((b->mux >> 8) & 15))) {
        b->channel = b->mux & 15;
    } else {
        b->channel = (channel + (b->ranges[channel] & DIFFERENTIAL ? 2 : 1)) % INPUTS;
    }
    if (b->control & INTERRUPT_ENABLED && (!(b->control & AT_HALF_FULL) || b->count >= FIFO / 2)) {
        b->interrupt = true;
        update_interrupt(b);
    }
}

/* A conversion by software ends a conversion time after its trigger; each look at the board takes bus time, too. */
static void end_conversion(Board *b)
{
    if (b->converting &&
        now_ns() - b->started_ns + ++b->accesses * ACCESS_NS >= FAMILY_GET_CLASS(b)->conversion_ns) {
        b->converting = false;
        convert(b, now_ns());
    }
}

static int64_t pacer_ns(Board *b)
{
    int64_t ticks = 1;

    for (int i = 1; i < COUNTERS; i++) {
        ticks *= b->counters[i].divisor ? b->counters[i].divisor : 65536;
    }
    return MAX(ticks * PACER_TICK_NS, FAMILY_GET_CLASS(b)->conversion_ns);
}

static bool paced(Board *b)
{
    return (b->control & BY_PACER) && b->counters[1].loaded && b->counters[2].loaded;
}

static void pacer_tick(void *opaque)
{
    Board *b = opaque;

    while (paced(b) && b->next_ns <= now_ns()) {
        convert(b, b->next_ns);
        b->next_ns += pacer_ns(b);
    }
    if (paced(b)) {
        timer_mod(b->pacer, b->next_ns);
    }
}

static void update_pacer(Board *b, bool was_paced)
{
    if (paced(b) && !was_paced) {
        b->next_ns = now_ns() + pacer_ns(b);
        timer_mod(b->pacer, b->next_ns);
    } else if (!paced(b)) {
        timer_del(b->pacer);
    }
}

/* The 8254: the modes that the board's wiring uses, loaded low byte first. */
static void counter_command(Board *b, uint8_t word)
{
    Counter *c = &b->counters[(word >> 6) & 3];

    if ((word >> 6) == 3) {
        /* Read-back of counter 0: its count, or its status. */
        b->counters[0].latched = word;
        b->counters[0].high_next = false;
        return;
    }
    *c = (Counter){.mode = (word >> 1) & 7};
}

static void counter_write(Board *b, unsigned which, uint8_t byte)
{
    Counter *c = &b->counters[which];

    if (!c->high_next) {
        c->divisor = byte;
        c->loaded = false;
    } else {
        c->divisor |= byte << 8;
        c->loaded = true;
        c->since_ns = now_ns();
    }
    c->high_next = !c->high_next;
}

static uint8_t counter_read(Board *b, unsigned which)
{
    Counter *c = &b->counters[which];

    if (which == 0 && !(c->latched & 0x10) && c->latched & 0x80) {
        return c->loaded ? 0 : 0x40; /* status: bit 6 while no count is loaded */
    }
    c->high_next = !c->high_next;
    return c->high_next ? c->divisor : c->divisor >> 8;
}

static uint64_t board_read(void *opaque, hwaddr at, unsigned size)
{
    Board *b = opaque;
    uint16_t value;

    if (b->hung) {
        return size == 1 ? 0xff : 0xffff;
    }
    switch (at & ~1) {
    case AD_DATA:
        if (b->count) {
            b->last = b->fifo[b->first];
            b->first = (b->first + 1) % FIFO;
            b->count--;
        }
        value = b->last;
        break;
    case STATUS:
        end_conversion(b);
        value = (b->control & 0x7f) | (b->count ? 0 : EMPTY) | (b->count >= FIFO / 2 ? HALF_FULL : 0) |
                (b->count == FIFO ? FULL : 0) | (b->interrupt || b->storm ? INTERRUPT : 0);
        break;
    case DIGITAL:
        value = b->digital_in | b->contacts;
        break;
    case BOARD_ID:
        value = 0;
        break;
    case COUNTER0 ... COUNTER0 + 4:
        value = counter_read(b, (at - COUNTER0) / 2);
        break;
    default:
        value = 0xffff; /* write only: nothing drives the bus */
    }
    return size == 1 && (at & 1) ? value >> 8 : value;
}

static void board_write(void *opaque, hwaddr at, uint64_t value, unsigned size)
{
    Board *b = opaque;
    bool was_paced = paced(b);

    if (b->hung) {
        return;
    }
    switch (at) {
    case SOFT_TRIGGER:
        if (b->control & BY_SOFTWARE) {
            b->converting = true;
            b->started_ns = now_ns();
            b->accesses = 0;
        }
        break;
    case RANGE:
        b->ranges[b->channel] = value;
        break;
    case MUX:
        b->mux = value;
        b->channel = value & 15;
        break;
    case CONTROL:
        b->control = value;
        break;
    case CLEAR_INTERRUPT:
        b->interrupt = false;
        update_interrupt(b);
        break;
    case CLEAR_FIFO:
        b->count = 0;
        b->converting = false;
        break;
    case DA0:
    case DA1:
        b->codes[(at - DA0) / 2] = value;
        update_outputs(b);
        break;
    case DA_REFERENCE:
        b->reference = value;
        update_outputs(b);
        break;
    case DIGITAL:
        b->digital_out = value;
        b->digital_written_ns = now_ns();
        b->digital_writes[b->digital_count++ % DIGITAL_WRITES] = (DigitalWrite){b->digital_written_ns, value};
        bench_exchange(b, now_ns());
        break;
    case COUNTER0:
    case COUNTER0 + 2:
    case COUNTER0 + 4:
        counter_write(b, (at - COUNTER0) / 2, value);
        break;
    case COUNTER_CONTROL:
        counter_command(b, value);
        break;
    }
    update_pacer(b, was_paced);
}

static const MemoryRegionOps window_ops = {
    .read = board_read,
    .write = board_write,
    .endianness = DEVICE_LITTLE_ENDIAN,
    .impl = {.min_access_size = 1, .max_access_size = 2},
};

static void board_reset(DeviceState *device)
{
    Board *b = FAMILY(device);

    b->control = b->mux = b->digital_out = 0;
    b->reference = FAMILY_GET_CLASS(b)->tagged ? 0 : 0x0202; /* 0 to 5 V */
    b->channel = b->first = b->count = 0;
    b->interrupt = b->converting = false;
    memset(b->ranges, 0, sizeof(b->ranges));
    memset(b->counters, 0, sizeof(b->counters));
    memset(b->codes, 0, sizeof(b->codes));
    timer_del(b->pacer);
    update_interrupt(b);
    update_outputs(b);
}

/* The board claims an interrupt again as soon as one is cleared, for so long: its driver cannot refuse it. */
static void storm_over(void *opaque)
{
    Board *b = opaque;

    b->storm = false;
    update_interrupt(b);
}

static void board_realize(PCIDevice *pci, Error **errp)
{
    Board *b = FAMILY(pci);

    if (!b->bench_period_us) {
        error_setg(errp, "bench-period-us must not be 0");
        return;
    }
    pci_config_set_interrupt_pin(pci->config, 1);
    memory_region_init_io(&b->window, OBJECT(b), &window_ops, b, "pci1716", WINDOW);
    pci_register_bar(pci, 2, PCI_BASE_ADDRESS_SPACE_IO, &b->window);
    b->pacer = timer_new_ns(QEMU_CLOCK_VIRTUAL, pacer_tick, b);
    b->watch = timer_new_ns(QEMU_CLOCK_VIRTUAL, bench_watch, b);
    b->storm_end = timer_new_ns(QEMU_CLOCK_VIRTUAL, storm_over, b);
}

static void board_exit(PCIDevice *pci)
{
    Board *b = FAMILY(pci);

    timer_free(b->pacer);
    timer_free(b->watch);
    timer_free(b->storm_end);
}

/* Faults and voltages, from QEMU's monitor: qom-set and qom-get. */
static void get_number(Object *object, Visitor *v, const char *name, void *opaque, Error **errp)
{
    visit_type_number(v, name, (double *)((char *)object + (uintptr_t)opaque), errp);
}

static bool get_irq_stuck(Object *object, Error **errp)
{
    return FAMILY(object)->irq_stuck;
}

static void set_irq_stuck(Object *object, bool stuck, Error **errp)
{
    FAMILY(object)->irq_stuck = stuck;
    update_interrupt(FAMILY(object));
}

static void get_storm_ms(Object *object, Visitor *v, const char *name, void *opaque, Error **errp)
{
    Board *b = FAMILY(object);
    uint32_t left_ms = b->storm ? MAX(0, timer_expire_time_ns(b->storm_end) - now_ns()) / 1000000 : 0;

    visit_type_uint32(v, name, &left_ms, errp);
}

static void set_storm_ms(Object *object, Visitor *v, const char *name, void *opaque, Error **errp)
{
    Board *b = FAMILY(object);
    uint32_t lasts_ms;

    if (visit_type_uint32(v, name, &lasts_ms, errp)) {
        b->storm = lasts_ms > 0;
        timer_mod(b->storm_end, now_ns() + lasts_ms * 1000000LL);
        update_interrupt(b);
    }
}

static bool get_irq_lost(Object *object, Error **errp)
{
    return FAMILY(object)->irq_lost;
}

static void set_irq_lost(Object *object, bool lost, Error **errp)
{
    FAMILY(object)->irq_lost = lost;
    update_interrupt(FAMILY(object));
}

static bool get_coupled(Object *object, Error **errp)
{
    return FAMILY(object)->coupled;
}

static void set_coupled(Object *object, bool coupled, Error **errp)
{
    Board *b = FAMILY(object);

    if (coupled && !qemu_chr_fe_backend_connected(&b->bench)) {
        error_setg(errp, "the board has no bench");
        return;
    }
    b->coupled = coupled;
    if (coupled) {
        bench_exchange(b, now_ns());
        timer_mod(b->watch, now_ns() + b->bench_period_us * 1000LL);
    } else {
        timer_del(b->watch);
    }
}

/* As a short interruption of the board's supply: it answers again at once, without what was written before. */
static void set_reset(Object *object, bool reset, Error **errp)
{
    if (reset) {
        board_reset(DEVICE(object));
    }
}

static void get_contacts(Object *object, Visitor *v, const char *name, void *opaque, Error **errp)
{
    visit_type_uint16(v, name, &FAMILY(object)->contacts, errp);
}

/* Contacts at the digital inputs, one bit each: closed ones are high, beside what the bench sets. */
static void set_contacts(Object *object, Visitor *v, const char *name, void *opaque, Error **errp)
{
    if (visit_type_uint16(v, name, &FAMILY(object)->contacts, errp)) {
        FAMILY(object)->contacts_changed_ns = now_ns();
    }
}

/* The last writes to the digital outputs, oldest first: value:ns, separated by spaces. */
static char *get_digital_writes(Object *object, Error **errp)
{
    Board *b = FAMILY(object);
    GString *text = g_string_new(NULL);
    unsigned first = b->digital_count > DIGITAL_WRITES ? b->digital_count - DIGITAL_WRITES : 0;

    for (unsigned k = first; k < b->digital_count; k++) {
        DigitalWrite *one = &b->digital_writes[k % DIGITAL_WRITES];
        g_string_append_printf(text, "%u:%" PRIu64 " ", one->value, one->t_ns);
    }
    return g_string_free(text, FALSE);
}

static bool get_hung(Object *object, Error **errp)
{
    return FAMILY(object)->hung;
}

static void set_hung(Object *object, bool hung, Error **errp)
{
    FAMILY(object)->hung = hung;
}

static void board_init(Object *object)
{
    Board *b = FAMILY(object);

    for (int i = 0; i < INPUTS; i++) {
        g_autofree char *name = g_strdup_printf("ai%d", i);
        object_property_add(object, name, "number", get_number, get_number, NULL,
                            (void *)(offsetof(Board, inputs_v) + i * sizeof(double)));
    }
    for (int i = 0; i < OUTPUTS; i++) {
        g_autofree char *name = g_strdup_printf("ao%d", i);
        object_property_add(object, name, "number", get_number, NULL, NULL,
                            (void *)(offsetof(Board, outputs_v) + i * sizeof(double)));
    }
    object_property_add_bool(object, "coupled", get_coupled, set_coupled);
    object_property_add_bool(object, "hung", get_hung, set_hung);
    object_property_add_bool(object, "irq-lost", get_irq_lost, set_irq_lost);
    object_property_add_bool(object, "irq-stuck", get_irq_stuck, set_irq_stuck);
    object_property_add(object, "irq-storm-ms", "uint32", get_storm_ms, set_storm_ms, NULL, NULL);
    object_property_add_uint32_ptr(object, "open-inputs", &b->open_inputs, OBJ_PROP_FLAG_READWRITE);
    object_property_add_uint64_ptr(object, "overruns", &b->overruns, OBJ_PROP_FLAG_READ);
    object_property_add_bool(object, "reset", NULL, set_reset);
    object_property_add_uint64_ptr(object, "outputs-changed-ns", &b->outputs_changed_ns, OBJ_PROP_FLAG_READ);
    object_property_add_uint64_ptr(object, "digital-written-ns", &b->digital_written_ns, OBJ_PROP_FLAG_READ);
    object_property_add(object, "contacts", "uint16", get_contacts, set_contacts, NULL, NULL);
    object_property_add_uint64_ptr(object, "contacts-changed-ns", &b->contacts_changed_ns, OBJ_PROP_FLAG_READ);
    object_property_add_str(object, "digital-writes", get_digital_writes, NULL);
    object_property_add_uint64_ptr(object, "conversions", &b->conversions, OBJ_PROP_FLAG_READ);
}

static Property properties[] = {
    DEFINE_PROP_CHR("bench", Board, bench),
    DEFINE_PROP_UINT32("bench-period-us", Board, bench_period_us, 1000),
    DEFINE_PROP_END_OF_LIST(),
};

static void family_class_init(ObjectClass *class, void *data)
{
    DeviceClass *dc = DEVICE_CLASS(class);
    PCIDeviceClass *k = PCI_DEVICE_CLASS(class);

    k->realize = board_realize;
    k->exit = board_exit;
    k->vendor_id = 0x13fe;
    k->subsystem_vendor_id = 0x13fe;
    k->class_id = PCI_CLASS_OTHERS;
    dc->reset = board_reset;
    dc->hotpluggable = false;
    set_bit(DEVICE_CATEGORY_MISC, dc->categories);
    device_class_set_props(dc, properties);
}

static void pci1716_class_init(ObjectClass *class, void *data)
{
    BoardClass *k = FAMILY_CLASS(class);

    k->parent_class.device_id = 0x1716;
    k->bits = 16;
    k->conversion_ns = 4000;
    k->bipolar = bipolar_1716;
    k->outputs = outputs_1716;
    k->reference_bits = 8;
    k->reference_mask = 7;
}

static void pci1711_class_init(ObjectClass *class, void *data)
{
    BoardClass *k = FAMILY_CLASS(class);

    k->parent_class.device_id = 0x1711;
    k->bits = 12;
    k->conversion_ns = 10000;
    k->bipolar = bipolar_1711;
    k->outputs = outputs_1711;
    k->reference_bits = 2;
    k->reference_mask = 3;
    k->tagged = true;
}

static const TypeInfo types[] = {
    {
        .name = TYPE_FAMILY,
        .parent = TYPE_PCI_DEVICE,
        .instance_size = sizeof(Board),
        .instance_init = board_init,
        .class_size = sizeof(BoardClass),
        .class_init = family_class_init,
        .abstract = true,
        .interfaces = (InterfaceInfo[]){{INTERFACE_CONVENTIONAL_PCI_DEVICE}, {}},
    },
    {.name = "pci1716", .parent = TYPE_FAMILY, .class_init = pci1716_class_init},
    {.name = "pci1711", .parent = TYPE_FAMILY, .class_init = pci1711_class_init},
};

DEFINE_TYPES(types)
