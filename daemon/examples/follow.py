"""Follows the wearer's pose: what a client in Python needs.

    pip install grpcio grpcio-tools
    python follow.py [SERVER] [COUNT]        (with posed running)
"""

import pathlib
import queue
import sys

import grpc

# Where posed/v1/*.proto are; a program of your own brings its copy.
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "proto"))
messages, services = grpc.protos_and_services("posed/v1/pose_service.proto")
pose_messages = grpc.protos("posed/v1/pose.proto")

HEAD = 15  # SMPL's index; proto/posed/v1/pose.proto lists all joints


def follow(server: str, count: int) -> None:
    # A credit is one pose: whoever grants the next only after the last always gets the newest, and
    # never works through a queue of old ones.
    credits = queue.SimpleQueue()
    credit = messages.FollowPosesRequest(credit=1)
    credits.put(credit)
    with grpc.insecure_channel(server) as channel:
        poses = services.PoseServiceStub(channel).FollowPoses(iter(credits.get, None))
        for number, message in enumerate(poses, start=1):
            pose = message.pose
            head = pose.joint_positions[HEAD]
            quality = pose_messages.Quality.Name(pose.quality)
            age_ms = (pose.publish_time_ns - pose.sample_time_ns) * 1e-6
            print(
                f"pose {pose.sequence} ({quality}): "
                f"head at {head.x:.3f} {head.y:.3f} {head.z:.3f} m, "
                f"measured {age_ms:.1f} ms before, {message.gap} skipped"
            )
            if number == count:
                break
            credits.put(credit)
        credits.put(None)  # no more credits: the stream's request side ends


if __name__ == "__main__":
    follow(*(sys.argv[1:2] or ["127.0.0.1:50770"]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
