"""What measures the methods against other programs and against what is claimed of them, for pages of docs/.

`claims` holds the claims of the paper and of the package against measurements. `rivals` runs other programs on the same
problems; `work_precision` compares them with our methods, `frontier` finds the best at each error, and `frontier_chart`
draws it. The scripts beside this folder are the commands: `claims.py`, `rivals.py`, `work_precision.py`. It is no part
of the package, whose scenes, closed forms and charts it takes from `midlie_jax.cli`.
"""
