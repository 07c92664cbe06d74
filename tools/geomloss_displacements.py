"""Write ``tests/data/geomloss_displacements.csv``: Table 1 of the bundled pair by GeomLoss.

Needs GeomLoss and torch (the extra ``bench``), which the tests and `tools/reproduce_paper.py`
then do not: both compare ``clmorph.sinkhorn(method="geomloss")`` with this file.
"""

import csv

from paper.geomloss import COLUMNS, STORED, displacements
from paper.pair import load_pair
from paper.setting import BLUR, COLOR_WEIGHT, PUBLISHED_DISPLACEMENTS, reach_name
from paper.table1 import MASK

import clmorph

#: The size of ``--quick``, and the paper's.
SIZES = (20, 48)


def main() -> None:
    pair = load_pair(None, None)
    with STORED.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for size in SIZES:
            measures = [
                clmorph.lift(image, COLOR_WEIGHT, extent="unit")
                for image in pair.as_published(size)
            ]
            for reach in PUBLISHED_DISPLACEMENTS:
                found = displacements(*measures, BLUR, reach, MASK)
                row = [size, reach_name(reach), *(f"{found[name]:.10g}" for name in COLUMNS[2:])]
                writer.writerow(row)
                print(*row)


if __name__ == "__main__":
    main()
