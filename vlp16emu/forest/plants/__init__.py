"""Growth of plants: the species table, stems, branches and leaves."""
