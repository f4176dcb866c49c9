"""The files of a transfer table: CSV, NPZ and Parquet."""

from pathlib import Path

import numpy as np

from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.studies.handover.transfer.columns import columns_of, inverse_columns, npz_arrays
from linkplan.studies.handover.transfer.serial_study import along_columns
from linkplan.studies.handover.transfer.serial_urdf import urdf_text
from linkplan.studies.handover.transfer.study import Transfer


def write_files(transfer: Transfer, place: Path, *, parquet: bool = False) -> None:
    """Write tables, serial.xml, serial.urdf and along.csv, as far as they exist.

    With `parquet`, the tables are written as Parquet too.
    """
    tables = {"table": columns_of(transfer), "inverse": inverse_columns(transfer)}
    mechanism = transfer.outputs.mechanism
    about = {"mechanism": mechanism.name, "joints": ",".join(joint.name for joint in transfer.outputs.joints)}
    for name, columns in tables.items():
        if columns is None:
            continue
        (place / f"{name}.csv").write_bytes(csv_bytes(columns))
        if parquet:
            (place / f"{name}.parquet").write_bytes(parquet_bytes(columns, about))
    if transfer.serial is not None:
        (place / "serial.xml").write_text(transfer.serial.model.text, encoding="utf-8")
        urdf = urdf_text(transfer)
        if urdf is not None:
            (place / "serial.urdf").write_text(urdf, encoding="utf-8")
        if transfer.serial.errors is not None:
            (place / "along.csv").write_bytes(csv_bytes(along_columns(transfer.serial)))
    np.savez_compressed(place / "table.npz", **npz_arrays(transfer))  # pyright: ignore[reportArgumentType]  arrays by name
