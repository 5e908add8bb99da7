"""English words of the report's page, and of the sentences that compare two methods."""

from collections.abc import Mapping

TEXT: Mapping[str, str] = {
    # Glue
    "colon": ": ",
    "comma": ", ",
    "semicolon": "; ",
    "stop": ".",
    "and": " and ",
    "list": ", ",
    "range": "{low} to {high}",
    "of_task": ": {task}",
    "undisturbed": "undisturbed",
    # Head
    "head.run": "Run {run}",
    "head.no_verdict": "Run without a verdict",
    "head.profile": "profile",
    "head.seed": "seed",
    "head.finished": "finished",
    "headlines.title": "What the trials show",
    "headlines.note": "Brackets: 95 % intervals (Newcombe for rates, bootstrap of the median difference "
    "for motions). All p-values are corrected for the number of comparisons (Holm). Simulation only.",
    "tile.of": "{part} of {all}",
    "tile.stages": "stages before this report pass",
    "tile.checks": "checks inside their limits",
    "tile.time": "for all stages",
    "nav.stages": "Stages",
    "state.pass": "Pass",
    "state.fail": "Fail",
    "state.weakened": "Weakened",
    "state.smoke": "Smoke: wiring only",
    "state.tainted": "Tainted",
    "status.pass": "pass",
    "status.fail": "fail",
    "status.error": "error",
    "status.missing": "missing",
    "status.reported": "reported",
    # Banners
    "banner.tainted_one": "Tainted: 1 gate opened by hand. This report cannot pass.",
    "banner.tainted": "Tainted: {n} gates opened by hand. This report cannot pass.",
    "banner.waiver": "gate of {stage}, {at}: “{reason}” ({blocking})",
    "banner.was": "{stage} was {state}",
    "banner.check": "{check}: {why}",
    "banner.fail": "This report does not pass",
    "banner.code": "Results of other code: this report cannot pass",
    "banner.smoke": "{profile}: wiring only, not acceptance",
    "banner.wiring_only": "Few trials and little training show that the parts fit together. "
    "The rates prove nothing else.",
    "banner.weakened": "Less was asked than the {profile} profile asks: not acceptance",
    "banner.overrides": "Values of the {profile} profile were overridden",
    "banner.commits": "The stages were run at {n} commits",
    # Tables of success
    "tasks.title": "Success in each task",
    "tasks.lead": "Undisturbed trials, and those of the condition with most trials; 95 % Wilson interval. "
    "Every method has the same starts and the same success test in a task.",
    "tasks.task": "Task",
    "cell.of": "{successes} of {trials}",
    "cell.spared": "does not apply",
    "cell.missing": "missing",
    "cell.none": "none",
    "cell.no_trial_completed": "no trial completed",
    "cell.median": "median {middle}",
    "cell.loss": "{points} points on {n} shared starts",
    "cell.stopped": "stopped itself in {n}",
    "cell.limit": "limit: ",
    # Comparison
    "comparison.title": "Comparison of the methods",
    "comparison.lead": "Every method has the same task, starts and success test. Nothing disturbs these "
    "trials. Bold: best of a column. Small: 95 % interval of the median over trials. A method without a "
    "success is shown but not ranked.",
    "comparison.star": "Star: better than the “excellent” limit in the last row.",
    "comparison.method": "Method",
    "comparison.excellent": "excellent",
    "comparison.no_limit": "no limit",
    "comparison.interval": "A 95 % interval made in this way holds the true value in 95 of 100 such "
    "experiments; the fewer trials, the wider it is. In the figures each method has a marker of its own; "
    "a cross is a failed trial, a bar the median of the successful ones.",
    "further.summary": "Stages reached, synchronisation, forces, work and times",
    "further.median": "Median over trials",
    "beside": "{text} (docs/results.md, Policies).",
    # Conditions
    "conditions.title": "Under disturbances",
    "conditions.lead": "The same starts as above. Methods are not told what has changed; they know only "
    "the age of a sensed pose, from its time stamp. Each cell: successes, their 95 % Wilson interval, and "
    "the change in points against the same starts undisturbed. A cell with a limit says what is promised "
    "and, in brackets, where it is checked. Nothing is promised for the other cells.",
    "conditions.condition": "Condition",
    "conditions.legend": "Shaded: a significant loss (exact McNemar test on shared starts, Holm's "
    "correction over all losses, p < {certain}). An unshaded difference is within what this number of "
    "trials can show by chance.",
    "conditions.more": "Completion time, torque, jerk, tilt and path under each condition",
    "conditions.over_successes": "median of the successful trials, 95 % interval",
    "conditions.over_trials": "median over trials, 95 % interval",
    # Analysis
    "analysis.title": "What the numbers show",
    "pairs.title": "Methods against each other",
    "pairs.lead": "Success on shared starts: exact McNemar test, p corrected for the number of pairs "
    "(Holm). Success differs where p < {certain}. Completion time over the starts on which both succeeded.",
    "pairs.pair": "Pair",
    "pairs.starts": "Starts",
    "pairs.only_first": "Only the first succeeds",
    "pairs.only_second": "Only the second",
    "pairs.difference": "Difference, points",
    "pairs.p": "p, and corrected",
    "pairs.result": "Success",
    "pairs.time": "First less second, s",
    "pairs.against": "{first} against {second}",
    "pairs.differ": "differs",
    "pairs.not_separated": "not separated by these trials",
    "pairs.no_shared_success": "no shared success",
    "effects.title": "Effects of disturbances that the trials show",
    "effects.none": "None: no change of success is significant.",
    "effects.loss": "{method} under {condition}: {points} points on {n} starts (95 % interval {low} to "
    "{high}, exact McNemar p = {p}, {corrected} corrected).",
    "effects.partings": "Methods that differ under the same disturbance:",
    "effects.parting": "{condition}: {first} against {second} {points} points (95 % interval {low} to "
    "{high}, p = {p}, {corrected} corrected).",
    "effects.failures": "What failed first under disturbances:",
    "effects.under": "{method} under {condition}: ",
    "failures.title": "What failed first, undisturbed",
    "failures.of": "{failed} of {trials} trials failed",
    "failure.phase": "{failure} (phase {phase})",
    # Policy and margins
    "margins.title": "Policy and margins",
    "policy.title": "Policy on held-out starts",
    "policy.gap": "Success on starts held out from training: {held_out} (95 % interval {low} to {high}). "
    "On starts of the training set: {training}, {points} points, {where} that interval.",
    "policy.inside": "inside",
    "policy.outside": "outside",
    "policy.set": "{successes} of {trials} succeed ({low} to {high})",
    "policy.by_seed": "training by training",
    "margins.thinnest": "Thinnest margins",
    "margins.line": "{check}, {share} {where} its limit.",
    "margins.inside": "inside",
    "margins.beyond": "beyond",
    "margins.at_best": "Not ranked: {n} checks at the best possible value or exactly at their limit, such "
    "as 100 % of the queries.",
    # Films, stages, the rest
    "films.title": "Films",
    "stages.title": "Every check of every stage",
    "stages.lead": "Notes and reasons of the checks stand in report.json.",
    "stages.checks": "{n} checks",
    "stages.checks_and_pictures": "{n} checks and pictures",
    "stages.absent": "This stage left no verdict.",
    "stages.held": "{of} limits held",
    "check.check": "Check",
    "check.observed": "observed",
    "check.limit": "limit",
    "check.margin": "margin",
    "check.result": "result",
    "check.remedy": "remedy: ",
    "check.sentence": "{name} is {observed}, limit {op} {bound}",
    "report.summary": "Build this page from the verdicts",
    "speed.title": "Speed",
    "speed.lead": "Measured by make bench at {commit}, {made_at}, on {processor}, {cores} cores. Ratios "
    "compare what ran in turns on the same machine; absolute times hold for this machine and its other "
    "work. No verdict of this run depends on them.",
    "made.title": "What it was made with",
    "footer": "Built by minidual report from the verdicts and artefacts of this run. It needs no network; "
    "the same numbers are in report.json. “moveit” names the planning method (OMPL and TOPP-RA); MoveIt "
    "itself is not inside. Everything here happened in simulation.",
    # Figures
    "figure.success": "Success",
    "figure.success_conditions": "Success under each condition",
    "figure.success_caption": "Markers: share of trials that passed. Lines: 95 % Wilson interval.",
    "figure.spared": "does not apply",
    "figure.missing": "missing",
    "figure.success_axis": "success, %",
    "figure.excellent": "excellent",
    # Sentences
    "on": "On {task}, {rest}",
    "on_under": "On {task} under {condition}, {rest}",
    "answer.more_often": "{better} succeeds more often than {worse}: {better_n} against {worse_n} of "
    "{trials_n} starts, {points} points more ({low} to {high}; McNemar {p})",
    "answer.where_both": "; where both succeed, {motions}",
    "answer.no_difference": "; no difference of success in {trials_n} starts ({first_n} and {second_n}, "
    "McNemar {p}; {needed})",
    "answer.end": ".",
    "answer.tests": "{motions} (paired t-test: {p})",
    "answer.needed_rates": "about {n} trials would tell at these rates",
    "answer.needed": "about {n} trials would show {points} points",
    "answer.cannot": "Cannot tell {first} and {second} apart on {task}: {first_n} and {second_n} of "
    "{trials_n} starts succeed, and no motion differs; {needed}.",
    "answer.cannot_several": "Cannot tell apart in success or motion: {pairs}; {needed}.",
    "answer.cannot_pair": "{first} and {second} on {task} ({first_n} and {second_n} of {trials_n} succeed)",
    "answer.cannot_more": "{n} more pairs",
    "motion.of": "{method} {phrases}",
    "motion.duration_s": "is {size} s faster ({low} to {high} s)",
    "motion.torque_ratio_max": "needs {size} points less peak torque ({low} to {high})",
    "motion.jerk_rms": "is {size} % smoother ({low} to {high} %)",
    "motion.internal_force_min_n": "holds with {size} N more internal force ({low} to {high} N)",
    "motion.pinch_force_min_n": "grips with {size} N more ({low} to {high} N)",
    "p.tiny": "p < 0.001",
    "p.each_tiny": "each p < 0.001",
    "p.each": "each p ≤ {p}",
    "p.equal": "p = {p}",
}
