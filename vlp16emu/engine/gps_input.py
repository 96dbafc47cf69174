"""Input of a sensor from its GPS receiver, and the pulse state that the sensor derives from it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vlp16emu.packets import rmc
from vlp16emu.random import Purpose, generator
from vlp16emu.sensor.steps import NEVER, Spans, Steps
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import FOREVER_NS, S_NS

STALE_NS = 5 * S_NS
"""Time without a sentence after which the sensor behaves as if it never had one (assumption: the window of
the pulse)."""
_PUNCTUAL = Steps(((0, 0),))
_PRINTABLE = range(0x30, 0x5B)  # garbled characters: digits, capitals, and those between them in ASCII


def pps_state(*, is_pulsed: bool, is_wrong: bool, is_steady: bool, is_set: bool) -> PpsState:
    """Return the state of the pulse as a sensor reports it (63-9243 Rev D, section 9.3.3 and appendix G).

    Parameters
    ----------
    is_pulsed : True if pulses come
    is_wrong : True if pulse or sentence contradict the clock
    is_steady : True if the pulse has been steady for its window
    is_set : True if the last sentence is not stale, and sets the clock
    """
    if not is_pulsed:
        return PpsState.ABSENT
    if is_wrong:
        return PpsState.ERROR
    return PpsState.LOCKED if is_steady and is_set else PpsState.SYNCHRONIZING


@dataclass(frozen=True)
class GpsInput:
    """Pulses and sentences of a receiver; the sensor is locked before the run. Times are UTC in ns.

    A sentence is identified by its second and is due `sentence_delay_ns` later. Without a receiver, or
    without disturbances, the state is constant: that receivers keep their pulse under trees is an assumption.
    """

    connected: bool
    sentence_delay_ns: int  # from the second's edge to the arrival of the sentence that names it
    pps_window_ns: int = 0  # time for which the pulse must be steady
    requires_valid: bool = False  # True if sentences of status V do not set the clock
    off: Spans = NEVER  # the sensor has no power
    lost: Spans = NEVER  # no pulse, from the first missing edge to the first that is back
    missing: Spans = NEVER  # sentences that are due do not come
    void: Spans = NEVER  # sentences that are due have status V
    garbled: tuple[tuple[int, int, int], ...] = ()
    """Begin and end of spans, and the number of characters that are replaced in sentences that are due."""
    late: Steps[int] = _PUNCTUAL
    """Delay of sentences that are due, beside `sentence_delay_ns`."""

    @cached_property
    def pps(self) -> Steps[PpsState]:
        """State of the pulse."""
        turns_ns = sorted(self._turns_ns())
        states = [(turn_ns, self._state_at(turn_ns)) for turn_ns in (-FOREVER_NS, *turns_ns)]
        kept = [states[0]]
        for turn_ns, state in states:
            if state is not kept[-1][1]:
                kept.append((turn_ns, state))
        return Steps(tuple(kept))

    def second_ns(self, t_ns: int) -> int | None:
        """Return the UTC second named by the sentence in the sensor's buffer; None without a sentence.

        The sentence names the last edge before it, so its age is up to a second plus the delay
        (63-9243 Rev D, figure 7-4).
        """
        if not self.connected:
            return None
        second_ns = (t_ns - self.sentence_delay_ns) // S_NS * S_NS
        while True:
            due_ns = second_ns + self.sentence_delay_ns
            missing = self.missing.at(due_ns)
            if not missing and self._arrival_ns(second_ns) <= t_ns:
                break
            before_ns = missing[0] if missing else due_ns
            second_ns = (before_ns - 1 - self.sentence_delay_ns) // S_NS * S_NS
        off = self.off.before(t_ns)
        if off and self._arrival_ns(second_ns) < off[1]:
            return None
        return second_ns

    def sentence(self, fix: GnssFix, seed: int) -> bytes:
        """Return the sentence of a fix as the sensor receives it; `seed` is the unit's."""
        due_ns = fix.t_ns + self.sentence_delay_ns
        text = rmc(replace(fix, valid=fix.valid and not self.void.at(due_ns)))
        if self._wrong.at(due_ns):
            for begin_ns, end_ns, characters in self.garbled:
                if begin_ns <= due_ns < end_ns:
                    text = _garble(text, characters, generator(seed, Purpose.SENTENCE, fix.t_ns // S_NS))
        return text

    @cached_property
    def _wrong(self) -> Spans:
        return Spans.union((begin_ns, end_ns) for begin_ns, end_ns, _ in self.garbled)

    def _state_at(self, t_ns: int) -> PpsState:
        """Return the state of the pulse at an instant.

        Pulses are locked if they were steady for the window and their sentences name the second before them;
        a sentence that is garbled, or names another second, is an error. The end of a state is an assumption:
        a state from pulses ends at the first missing edge, a state from a sentence at the next sentence, or
        after 5 s without one.
        """
        is_pulsed = self.connected and not self.lost.at(t_ns // S_NS * S_NS) and not self.off.at(t_ns)
        since_ns = [span[1] for spans in (self.lost, self.off) if (span := spans.before(t_ns))]
        is_steady = not since_ns or t_ns >= max(since_ns) + self.pps_window_ns
        second_ns = self.second_ns(t_ns)
        if second_ns is None or t_ns - self._arrival_ns(second_ns) >= STALE_NS:
            return pps_state(is_pulsed=is_pulsed, is_wrong=False, is_steady=is_steady, is_set=False)
        due_ns = second_ns + self.sentence_delay_ns
        is_wrong = self._wrong.at(due_ns) is not None or self._arrival_ns(second_ns) >= second_ns + S_NS
        return pps_state(
            is_pulsed=is_pulsed,
            is_wrong=is_steady and is_wrong,
            is_steady=is_steady,
            is_set=not (self.requires_valid and self.void.at(due_ns)),
        )

    def _arrival_ns(self, second_ns: int) -> int:
        due_ns = second_ns + self.sentence_delay_ns
        return due_ns + self.late.at(due_ns)

    def _turns_ns(self) -> set[int]:
        """Return instants at which the state may change: pulses and sentences near ends of disturbances."""
        turns_ns = {bound_ns for span in self.off for bound_ns in span}
        turns_ns |= {end_ns + self.pps_window_ns for _, end_ns in (*self.off, *self.lost)}
        longest_ns = max(delay_ns for _, delay_ns in self.late.steps)
        bounds_ns = {turn_ns for turn_ns, _ in self.late.steps[1:]}
        for spans in (self.lost, self.missing, self.void, self._wrong):
            bounds_ns.update(bound_ns for span in spans for bound_ns in span)
        reached = [(bound_ns, 0) for bound_ns in bounds_ns]
        # A late sentence from before the power is back may be the first that the sensor gets.
        reached += [(bound_ns, longest_ns) for span in self.off for bound_ns in span]
        seconds = set[int]()
        for bound_ns, more_ns in reached:
            if bound_ns < FOREVER_NS:
                before_ns = bound_ns - 2 * S_NS - self.sentence_delay_ns - more_ns
                seconds.update(range(before_ns // S_NS, (bound_ns + STALE_NS) // S_NS + 3))
        for second in seconds:
            comes_ns = self._arrival_ns(second * S_NS)
            turns_ns |= {second * S_NS, comes_ns, comes_ns + STALE_NS}
        return turns_ns


def _garble(sentence: bytes, characters: int, random: np.random.Generator) -> bytes:
    """Return a sentence in which so many characters are replaced, so that its checksum is wrong."""
    text = bytearray(sentence)
    body = range(len(b"$GPRMC,"), text.index(b"*"))
    for place in random.choice(body, min(characters, len(body)), replace=False).tolist():
        other_codes = [code for code in _PRINTABLE if code != text[place]]
        text[place] = other_codes[int(random.integers(len(other_codes)))]
    summed = np.bitwise_xor.reduce(np.frombuffer(bytes(text[1 : text.index(b"*")]), np.uint8))
    if b"%02X" % int(summed) == text[-4:-2]:  # changes of several characters may cancel
        text[-3] = ord("1") if text[-3] == ord("0") else ord("0")
    return bytes(text)
