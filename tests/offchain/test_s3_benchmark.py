"""`bench custody` over a bucket: every custodian in a part of its own, and nothing is left."""

from __future__ import annotations

from network.bench.clips_apart import ClipsApart
from network.bench.custody.custody_bench import CustodyFigures, CustodyOptions, run_custody_benchmark
from node.clips_place import ClipsPlace
from tests.offchain.weed import S3Server


async def test_a_measurement_over_a_bucket_loses_no_clip_and_leaves_no_object(
    s3_place: ClipsPlace, s3_server: S3Server
) -> None:
    apart = ClipsApart(s3_place.url, s3_place.endpoint, credentials_path=s3_place.credentials_path)
    done: list[int] = []

    def count_objects(text: str) -> None:
        if text.startswith(("erasing: 1", "catching up")):
            done.append(s3_server.client().list_objects_v2(Bucket=s3_place.bucket)["KeyCount"])

    options = CustodyOptions(erasures=2, behind=50, frames=2, frame_bytes=500, apart=apart)
    result = await run_custody_benchmark(options, count_objects)
    assert isinstance(result.figures, CustodyFigures)
    assert (result.ok, result.figures.errors, result.figures.clips_lost) == (True, 0, 0)
    assert (result.conditions["clips"], len(done), min(done) > 0) == ("s3", 2, True)
    assert s3_server.client().list_objects_v2(Bucket=s3_place.bucket)["KeyCount"] == 0
