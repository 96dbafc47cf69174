"""Datasets: their file, their walks and the manifest.

Walks are made by this process, by others or by a cluster. The folder of each walk lists its own files with
their sha256, and the manifest joins these lists. Unlisted files are never removed.
"""

from vlp16emu.extras.dataset.estimate import DatasetEstimate, Probe, estimate_dataset
from vlp16emu.extras.dataset.run import DatasetResult, make_dataset
from vlp16emu.extras.dataset.spec import DatasetSpec, DatasetWalk, load_spec, walks_of

__all__ = [
    "DatasetEstimate",
    "DatasetResult",
    "DatasetSpec",
    "DatasetWalk",
    "Probe",
    "estimate_dataset",
    "load_spec",
    "make_dataset",
    "walks_of",
]
