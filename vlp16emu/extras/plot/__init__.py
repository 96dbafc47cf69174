"""Pictures of reports, drawn with matplotlib from the trees that `--json` prints."""
