"""The claims about the methods on trial: each property is measured, and a verdict computed from what was measured.

`measure` finds the numbers of one method (`structure` its defects of symplecticity, `counting` the work of a step,
`drift` the published drift test), `verdicts` holds them against what the paper and the registry claim, and `page`
writes docs/reports/claims.md. `command` does all of it, for `benchmarks/claims.py`.
"""
