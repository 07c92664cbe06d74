"""
Checking a device
=================

``clmorph check`` compares every operation of a device with NumPy, and prints how near to its
tolerance each comes. Here the same is done for one kernel, from Python.
"""

import re
import subprocess
import sys

import matplotlib.pyplot as plt

command = [sys.executable, "-m", "clmorph", "check", "--kernel", "log_sum_exp.cl"]
checked = subprocess.run(command, capture_output=True, text=True, check=True)
print(checked.stdout)

# %%
# The errors as shares of their tolerances.

shares = [float(each) for each in re.findall(r"([\d.]+) ?%", checked.stdout)]
plt.figure(figsize=(6, 2.6), layout="constrained")
plt.bar(range(len(shares)), shares)
plt.axhline(100, color="C3")
plt.ylabel("% of the tolerance")
plt.xlabel("comparison")
