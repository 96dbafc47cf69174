"""How plants grow: the species table, stems, branches and leaves."""
