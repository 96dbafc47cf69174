"""Many walks from one file: stands, seeds, sensors and paths, on all cores, a share of them on each machine."""

from vlp16emu.extras.dataset.run import DatasetResult, DatasetSpec, DatasetWalk, load_spec, make_dataset, walks_of

__all__ = ["DatasetResult", "DatasetSpec", "DatasetWalk", "load_spec", "make_dataset", "walks_of"]
