"""Table: the largest difference between the judge and `piezod simulate`, of each effect and hold [range]."""

from tests.foreign_judge.cases import CASES, HOLDS, differences

if __name__ == "__main__":
    print(f"{'effect':26}", *(f"{' '.join(str(value) for value in hold.values()):>12}" for hold in HOLDS))
    for name in CASES:
        print(f"{name:26}", *(f"{one:12.1e}" for one in differences(name)))
