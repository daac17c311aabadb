//! Starts the outputs that the configuration asks for.

use std::io;

use tokio::{runtime::Handle, sync::watch};

use super::{
    osc::{self, Targets},
    vmc::Vmc,
    vrchat::VrChat,
};
use crate::{config, grpc::Hub};

/// Starts to send to the receivers of VMC and to VRChat, if there are any, until the last pose was
/// published. `resets` changes when the wearer is reset. Answers where poses go, for people.
///
/// # Errors
/// A receiver's address cannot be sent to.
pub fn start(
    runtime: &Handle,
    hub: &Hub,
    resets: &watch::Receiver<u64>,
    vmc: &config::Vmc,
    vrchat: &config::VrChat,
) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    if !vmc.to.is_empty() {
        let targets = Targets::open(&vmc.to)?;
        runtime.spawn(osc::send(
            Vmc::new(),
            targets,
            vmc.rate_hz,
            hub.clone(),
            resets.clone(),
        ));
        names.extend(vmc.to.iter().map(|to| format!("VMC to {to}")));
    }
    if !vrchat.to.is_empty() {
        let targets = Targets::open(&vrchat.to)?;
        let encoder = VrChat::new(&vrchat.parts, vrchat.align_head);
        runtime.spawn(osc::send(
            encoder,
            targets,
            vrchat.rate_hz,
            hub.clone(),
            resets.clone(),
        ));
        names.extend(
            vrchat
                .to
                .iter()
                .map(|to| format!("VRChat trackers to {to}")),
        );
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use std::{net::UdpSocket, time::Duration};

    use posed_signal::{HostTime, time::MILLISECOND_NS};

    use super::*;
    use crate::{output::osc::tests::decode, published::tests::pose_at};

    #[tokio::test(flavor = "multi_thread")]
    async fn each_output_goes_to_its_own_receivers() {
        let ears = [0, 1].map(|_| UdpSocket::bind("127.0.0.1:0").unwrap());
        let addrs = ears.each_ref().map(|ear| ear.local_addr().unwrap());
        let vmc = config::Vmc {
            to: vec![addrs[0]],
            ..config::Vmc::default()
        };
        let vrchat = config::VrChat {
            to: vec![addrs[1]],
            ..config::VrChat::default()
        };
        let (mut sink, hub) = Hub::new().unwrap();
        let (resets, seen) = watch::channel(0);
        let runtime = Handle::current();
        let names = start(&runtime, &hub, &seen, &vmc, &vrchat).unwrap();
        assert_eq!(names.len(), 2);
        let nothing = (config::Vmc::default(), config::VrChat::default());
        assert!(
            start(&runtime, &hub, &seen, &nothing.0, &nothing.1)
                .unwrap()
                .is_empty()
        );
        resets.send_replace(1);
        let mut sequence = 0;
        for (ear, address) in ears
            .iter()
            .zip(["/VMC/Ext/Root/Pos", "/tracking/trackers/1/position"])
        {
            ear.set_read_timeout(Some(Duration::from_millis(20)))
                .unwrap();
            let mut buffer = [0; 2048];
            // The senders may not have begun to listen: poses are published until one is heard.
            let length = loop {
                sequence += 1;
                sink.publish(&pose_at(
                    sequence,
                    HostTime(sequence * 100 * MILLISECOND_NS),
                ));
                if let Ok(length) = ear.recv(&mut buffer) {
                    break length;
                }
                assert!(sequence < 1000, "{address} is not heard");
            };
            assert_eq!(decode(&buffer[..length])[0].address, address);
        }
    }
}
