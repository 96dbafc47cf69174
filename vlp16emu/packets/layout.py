"""Layout of both payloads as dtypes. All integers are little-endian.

>>> DATA_PAYLOAD.itemsize, BLOCK.itemsize, POSITION_PAYLOAD.itemsize
(1206, 100, 512)
>>> [DATA_PAYLOAD.fields[name][1] for name in ("timestamp_us", "return_mode", "factory")]
[1200, 1204, 1205]
>>> [POSITION_PAYLOAD.fields[name][1] for name in ("timestamp_us", "pps", "sentence")]
[198, 202, 206]

Source: 63-9243 Rev D, section 9.3.2 (data, p. 56, table 9-2) and section 9.3.3 (position, p. 60).
The manual counts from the start of the Ethernet frame; offsets here count from the payload, 42 less.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType

import numpy as np

from vlp16emu.sensor.beams import BLOCK_RECORDS, MODELS, SEQUENCE_NS, Model
from vlp16emu.types import I8, AnyArray, ReturnMode, SensorModel
from vlp16emu.units import US_NS

BLOCKS_PER_PACKET = 12  # Source: 63-9243 Rev D, section 9.3.2, p. 56.
RECORDS_PER_PACKET = BLOCKS_PER_PACKET * BLOCK_RECORDS
AZIMUTH_CODES = 36_000  # Hundredths of a degree, 0 .. 35999. Source: 63-9243 Rev D, section 9.3.1.4.

RETURN_MODE_BYTE = MappingProxyType(
    {ReturnMode.STRONGEST: 0x37, ReturnMode.LAST: 0x38, ReturnMode.DUAL: 0x39}
)
"""First factory byte. Source: 63-9243 Rev D, table 9-2, p. 56."""
PRODUCT_BEFORE_RELEASE = 0x21
"""Product byte of a VLP-16 of 2014; also an HDL-32E's (63-9243 Rev D, table 9-2), so the byte alone is
ambiguous."""

RECORD = np.dtype([("distance_lsb", "<u2"), ("reflectivity", "u1")])  # One laser's return, 3 bytes
BLOCK = np.dtype([("flag", "<u2"), ("azimuth_cdeg", "<u2"), ("records", RECORD, (BLOCK_RECORDS,))])
"""Up to 32 lasers of a firing sequence, or two sequences of 16, in 100 bytes; the azimuth belongs to the
first pulse of the sequence, of two of the first one."""
DATA_PAYLOAD = np.dtype(
    [
        ("blocks", BLOCK, (BLOCKS_PER_PACKET,)),
        ("timestamp_us", "<u4"),  # past the hour, at the first pulse of the first block
        ("return_mode", "u1"),
        ("factory", "u1"),
    ]
)
"""UDP payload of a data packet, 1206 bytes."""
DATA_BYTES = DATA_PAYLOAD.itemsize
DATA_ROW = np.dtype(
    [
        ("number", "<i8"),  # frame number in the capture, from 1, as in Wireshark
        ("arrival_ns", "<i8"),  # UTC stamp of the capture, or of sending
        ("sensor_ns", "<i8"),  # UTC of the stamp, mostly of the first pulse, by the sensor's clock
        ("utc_ns", "<i8"),  # the same by the chosen clock
        *DATA_PAYLOAD.descr,
    ]
)
"""Row of a table of data packets: when a packet came, when it was fired, and the fields of its payload."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Places of records in the packets of a model in a return mode.

    A packet has `readings` azimuth readings, each of `banks` blocks with the lasers of one firing sequence,
    or of `per_reading` sequences; in dual return each block stands twice in a row.
    """

    model: Model
    copies: int  # 2 in dual return: the last return, and the strongest; else 1

    @property
    def banks(self) -> int:
        """Blocks of one return of a reading."""
        return len(self.model.flags)

    @property
    def per_reading(self) -> int:
        """Firing sequences of a reading."""
        return self.model.beams.per_reading

    @property
    def readings(self) -> int:
        """Azimuth readings of a packet."""
        return BLOCKS_PER_PACKET // (self.banks * self.copies)

    @property
    def sequences(self) -> int:
        """Firing sequences of a packet."""
        return self.readings * self.per_reading

    @property
    def blocks(self) -> int:
        """Blocks that are used; the others hold nothing."""
        return self.readings * self.banks * self.copies

    @property
    def reading_ns(self) -> int:
        """Time between two azimuth readings."""
        return self.per_reading * self.model.beams.sequence_ns

    @property
    def period_ns(self) -> int:
        """Time from packet to packet."""
        return self.readings * self.reading_ns

    @property
    def age_ns(self) -> int:
        """Time from the stamp of a packet to its sending, at the end of its last firing sequence."""
        return self.period_ns - self.model.stamp_after_ns

    @property
    def steps_us(self) -> tuple[int, int]:
        """Least and greatest regular step of the stamps of packets."""
        if self.model.period_us is None:
            return self.period_ns // US_NS, self.period_ns // US_NS + 1
        least_us, most_us = self.model.period_us
        singles = BLOCKS_PER_PACKET // self.banks
        return least_us * self.readings // singles, most_us * self.readings // singles + 1

    def measured_period_ns(self, step_us: I8) -> int:
        """Return the time from packet to packet: the manual's, or of a model whose units differ the mean.

        `step_us` (n,) are steps of stamps; only regular ones count.
        """
        regular_us = self.regular_us(step_us)
        return self.mean_period_ns(int(regular_us.sum()), len(regular_us))

    def regular_us(self, step_us: I8) -> I8:
        """Return those steps (n,) of stamps that are regular."""
        least_us, most_us = self.steps_us
        return step_us[(step_us >= least_us) & (step_us <= most_us)]

    def mean_period_ns(self, total_us: int, steps: int) -> int:
        """Return the time from packet to packet as `measured_period_ns`, from the sum of regular steps."""
        if self.model.period_us is None or not steps:
            return self.period_ns
        return round(total_us / steps * US_NS)

    def by_reading(self, blocks: AnyArray) -> AnyArray:
        """View arrays (n, 12, ...) of blocks as (n, readings, banks, copies, ...), without unused blocks."""
        shape = len(blocks), self.readings, self.banks, self.copies
        return blocks[:, : self.blocks].reshape(*shape, *blocks.shape[2:])

    def by_laser(self, records: AnyArray) -> AnyArray:
        """Return records (n, 12, 32) as (n, readings * copies, per_reading, L), the last return first."""
        of_readings = self.by_reading(records).swapaxes(2, 3)
        return of_readings.reshape(
            len(records), self.readings * self.copies, self.per_reading, self.model.lasers
        )

    @cached_property
    def places(self) -> I8:
        """(m, 6) a row for each record of a packet, in the order of the pulses.

        Its columns are slot, block, laser, ns since the packet's stamp, ns since the azimuth reading, and 1
        for the second of a pair.
        """
        model = self.model
        slot = np.arange(self.blocks * BLOCK_RECORDS)
        block = slot // BLOCK_RECORDS
        copy = block % self.copies
        bank = block // self.copies % self.banks
        reading = block // (self.copies * self.banks)
        pulse = bank * BLOCK_RECORDS + slot % BLOCK_RECORDS  # of those of a reading
        sequence, laser = np.divmod(pulse, model.lasers)
        after_ns = sequence * model.beams.sequence_ns + model.beams.firing_ns[laser]
        since_ns = reading * self.reading_ns + after_ns - model.stamp_after_ns
        rows = np.stack([slot, block, laser, since_ns, after_ns, copy], axis=1)
        return rows[np.lexsort((copy, pulse, since_ns))]


@cache
def layout_of(model: SensorModel, mode: ReturnMode) -> Layout:
    """Return the layout of the packets of a model in a return mode."""
    return Layout(MODELS[model], 1 + (mode is ReturnMode.DUAL))


PRODUCTS = MappingProxyType({model.product: model.read_as for model in MODELS.values()})
"""Model by product byte."""
PRODUCT_WORDS = " or ".join(
    ", ".join(f"{code:#x}" for code in codes) for codes in (sorted(PRODUCTS)[:-1], sorted(PRODUCTS)[-1:])
)
"""The product bytes in words, for error lines."""
_MODES = {code: mode for mode, code in RETURN_MODE_BYTE.items()}


def layout_of_bytes(mode: int, product: int, model: SensorModel | None = None) -> Layout:
    """Return the layout of packets with factory bytes, of a VLP-16 in single return for unknown ones.

    `model` is that of a prototype unit, whose product byte is another sensor's.
    """
    named = PRODUCTS.get(product, SensorModel.VLP_16)
    is_prototype = model is not None and product == PRODUCT_BEFORE_RELEASE
    return layout_of(model if is_prototype and model else named, _MODES.get(mode, ReturnMode.STRONGEST))


def candidates(mode: int, product: int) -> list[Layout]:
    """Return the layouts that packets with these factory bytes may have: two if they may be a prototype's."""
    models = (None, SensorModel.VLP_16) if product == PRODUCT_BEFORE_RELEASE else (None,)
    return [layout_of_bytes(mode, product, model) for model in models]


LASERS = MODELS[SensorModel.VLP_16].lasers  # of a VLP-16, like the names below
SEQUENCES_PER_BLOCK = MODELS[SensorModel.VLP_16].beams.per_reading
SEQUENCES_PER_PACKET = MappingProxyType(
    {mode: layout_of(SensorModel.VLP_16, mode).sequences for mode in ReturnMode}
)
BLOCK_PERIOD_NS = SEQUENCES_PER_BLOCK * SEQUENCE_NS
DISTANCE_LSB_M = MODELS[SensorModel.VLP_16].distance_lsb_m
BLOCK_FLAG = MODELS[SensorModel.VLP_16].flags[0]  # of the first block of a packet of all models
BLOCK_FLAGS = frozenset(flag for model in MODELS.values() for flag in model.flags)
SPLIT_PRODUCTS = [model.product for model in MODELS.values() if len(model.flags) > 1]
"""Product bytes of models whose firing sequences are several blocks, with different flags."""

SENTENCE_BYTES = 128
"""Length of the field for the NMEA sentence, which ends with CR LF and is padded with NUL.

The VLP-16 manual gives no limit; the VLP-32C manual (63-9325) reserves 0xCE .. 0x14D.
"""
POSITION_PAYLOAD = np.dtype(
    [
        # Zero on all VLP-16 captures of 2014 to 2016; firmware of 2018 reports temperatures in the last 11.
        ("unused_head", "u1", (198,)),
        ("timestamp_us", "<u4"),  # past the hour
        ("pps", "u1"),  # PpsState
        ("unused_status", "u1", (3,)),  # thermal state in firmware of 2018
        ("sentence", f"S{SENTENCE_BYTES}"),
        ("unused_tail", "u1", (178,)),
    ]
)
"""UDP payload of a position packet, 512 bytes."""
POSITION_BYTES = POSITION_PAYLOAD.itemsize
