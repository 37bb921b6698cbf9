"""Checks a JobSet against jobset.schema.json, and writes the jobs in it into one file, which the schemas of Kubernetes are for.

    jobset.py JOBSET.yaml JOBS.yaml
"""

import json
import sys
from pathlib import Path

import jsonschema
import yaml

source, jobs = sys.argv[1:]
jobset = yaml.safe_load(Path(source).read_text())
schema = json.loads((Path(__file__).parent / "jobset.schema.json").read_text())
jsonschema.Draft202012Validator(schema).validate(jobset)
names = [job["name"] for job in jobset["spec"]["replicatedJobs"]]
assert set(jobset["spec"]["successPolicy"]["targetReplicatedJobs"]) <= set(names), names
kind = {"apiVersion": "batch/v1", "kind": "Job"}
every = [{**kind, "metadata": {"name": job["name"]}, **job["template"]} for job in jobset["spec"]["replicatedJobs"]]
Path(jobs).write_text(yaml.safe_dump_all(every))
