// Follows the wearer's pose in Unity: put this on an object that has the 22 joints as children.
//
// Packages: Grpc.Net.Client, Google.Protobuf (NuGet) and Cysharp.Net.Http.YetAnotherHttpHandler,
// which speaks HTTP/2 without TLS, as posed does on the loopback. Classes of Posed.V1 come from
// proto/posed/v1/*.proto:
//   protoc -I proto --csharp_out=Assets --grpc_out=Assets proto/posed/v1/*.proto

using System;
using System.Threading;
using System.Threading.Tasks;
using Cysharp.Net.Http;
using Grpc.Core;
using Grpc.Net.Client;
using Posed.V1;
using UnityEngine;

public sealed class PosedFollower : MonoBehaviour
{
    [SerializeField] string server = "http://127.0.0.1:50770";

    // In the order of proto/posed/v1/pose.proto: pelvis first, each under its parent.
    [SerializeField] Transform[] joints = new Transform[22];

    readonly CancellationTokenSource stop = new CancellationTokenSource();
    volatile Posed.V1.Pose newest;

    void OnEnable() => _ = Follow();

    void OnDisable() => stop.Cancel();

    async Task Follow()
    {
        var handler = new YetAnotherHttpHandler { Http2Only = true };
        var options = new GrpcChannelOptions { HttpHandler = handler, DisposeHttpClient = true };
        using (var channel = GrpcChannel.ForAddress(server, options))
        {
            var client = new PoseService.PoseServiceClient(channel);
            // A credit is one pose: whoever grants the next only after the last always gets the
            // newest, and never works through a queue of old ones.
            var credit = new FollowPosesRequest { Credit = 1 };
            try
            {
                using (var call = client.FollowPoses(cancellationToken: stop.Token))
                {
                    await call.RequestStream.WriteAsync(credit);
                    while (await call.ResponseStream.MoveNext(stop.Token))
                    {
                        newest = call.ResponseStream.Current.Pose;
                        await call.RequestStream.WriteAsync(credit);
                    }
                }
            }
            catch (RpcException error) when (error.StatusCode != StatusCode.Cancelled)
            {
                Debug.LogWarning("posed: " + error.Status.Detail);
            }
        }
    }

    void Update()
    {
        var pose = newest;
        if (pose == null) return;
        joints[0].localPosition = ToUnity(pose.Root);
        for (var index = 0; index < joints.Length; index++)
            joints[index].localRotation = ToUnity(pose.JointRotations[index]);
    }

    // posed is right-handed and looks along -Z, Unity is left-handed and looks along +Z.
    static UnityEngine.Vector3 ToUnity(Posed.V1.Vector3 v) =>
        new UnityEngine.Vector3(v.X, v.Y, -v.Z);

    static UnityEngine.Quaternion ToUnity(Posed.V1.Quaternion q) =>
        new UnityEngine.Quaternion(-q.X, -q.Y, q.Z, q.W);
}
