"""Read a campaign: print its rows and failure rates, and repeat its worst run."""

import sys

import taxinet_ros as tx

if len(sys.argv) != 2:
    print('usage: read_campaign.py CAMPAIGN, a folder', file=sys.stderr)
    sys.exit(2)
campaign = tx.open_campaign(sys.argv[1])
print(campaign.rows[['run_id', 'outcome', 'rho', 'time_of_day_h', 'clouds']].to_string())
for name, found in campaign.rates.items():
    print(f'{name}: {found.rate.words() if found.rate else found.why_not}')

if campaign.counterexamples:
    worst = min(campaign.counterexamples, key=lambda one: one.headline[1])
    specs = [f'{name}={formula}' for name, formula in campaign.facts['specs'].items()]
    run = tx.run(worst.scenario, perception=campaign.facts['perception'], specs=specs)
    print(f'{worst.run_id}: {run.outcome} again, {run}')
