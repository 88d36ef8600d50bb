"""cloud tracker draft"""
from __future__ import annotations
import numpy as np
from recorded import Firing, Recorded, EACH, Judge

class Cloud:
    def __init__(self, half, *, eps=0.025, explain=0.03, gain=0.3, alpha=np.pi, memory=6.0, cap=3.0, birth=1.0, step=0.0654, drift=0.03, lasts=60.0, lab=0.0):
        self.half=half; self.o=dict(eps=eps,explain=explain,gain=gain,alpha=alpha,memory=memory,cap=cap,birth=birth,step=step,drift=drift,lasts=lasts,lab=lab)
        self.p=np.zeros((0,2)); self.s=np.zeros(0); self.t=np.zeros(0); self.lo=np.zeros(0); self.hi=np.zeros(0); self.label=np.zeros(0,int); self.next=0
        self.mem=np.zeros((0,6))  # x,y,axis,free,time, 
    def keep(self, m):
        for n in ("p","s","t","lo","hi","label"): setattr(self,n,getattr(self,n)[m])
    def update(self, f: Firing, blind_range):
        o=self.o
        v=self.p-f.apex; rho=np.hypot(*v.T); ang=np.arctan2(v[:,1],v[:,0]); off=np.abs(np.mod(ang-f.axis+np.pi,2*np.pi)-np.pi)
        view=np.mod(ang+np.pi,2*np.pi)
        if not f.blind:
            free=(4.4 if f.silent else f.reading)-o["eps"]
            mid=0.5*(self.lo+self.hi); dv=np.mod(view-mid+np.pi,2*np.pi)-np.pi
            may=np.abs(dv)<=0.5*(self.hi-self.lo)+o["alpha"]
            carve=(off<self.half-0.03)&(rho<free)&may
            self.s=self.s-carve
            self.mem=np.vstack([self.mem,[*f.apex,f.axis,free,f.time,0]])
        self.mem=self.mem[self.mem[:,4]>f.time-o["memory"]]
        if not f.silent and not f.known:
            r=f.reading
            if f.blind: ex=(off<self.half+0.03)&(rho<blind_range+o["explain"])
            else: ex=(off<self.half+0.03)&(np.abs(rho-r)<o["explain"]+o["drift"]*np.minimum(f.time-self.t,1.0))
            ex&=self.s>0
            if ex.any():
                if not f.blind:
                    sh=o["gain"]*(r-rho[ex])/np.maximum(rho[ex],.05)
                    self.p[ex]+=v[ex]*sh[:,None]
                self.s[ex]=np.minimum(self.s[ex]+1,o["cap"]); self.t[ex]=f.time
                dv=(np.mod(view-self.lo+np.pi,2*np.pi)-np.pi)[ex]
                self.hi[ex]=np.maximum(self.hi[ex],self.lo[ex]+dv); self.lo[ex]=np.minimum(self.lo[ex],self.lo[ex]+dv)
            else:
                r=blind_range if f.blind else r
                n=int(2*self.half/o["step"])+1
                b=f.axis+np.linspace(-self.half,self.half,n)
                c=f.apex+r*np.stack([np.cos(b),np.sin(b)],1)
                isfree=self.free(c,f.time)
                if isfree.all(): isfree[:]=False
                c,b=c[~isfree],b[~isfree]; k=len(c)
                self.p=np.vstack([self.p,c]); self.s=np.append(self.s,np.full(k,o["birth"])); self.t=np.append(self.t,np.full(k,f.time))
                vw=np.mod(b+np.pi,2*np.pi); self.lo=np.append(self.lo,vw); self.hi=np.append(self.hi,vw)
                self.label=np.append(self.label,np.full(k,self.next)); self.next+=1
        self.keep((self.s>0)&(self.t>f.time-o["lasts"]))
    def free(self, c, t):
        m=self.mem[:-1]; 
        if not len(m): return np.zeros(len(c),bool)
        v=c[:,None,:]-m[None,:,:2]; rho=np.hypot(v[...,0],v[...,1]); age=t-m[:,4]; slack=self.o["drift"]*np.minimum(age,2.0)
        off=np.abs(np.mod(np.arctan2(v[...,1],v[...,0])-m[:,2]+np.pi,2*np.pi)-np.pi)
        inside=np.sin(np.clip(self.half-0.03-off,-1.5,1.5))*rho>slack
        return (inside&(rho<m[:,3]-slack)).sum(1)>=2

def replay(r: Recorded, radius=0.0, **kw):
    c=Cloud(r.array.half_angle,**kw); j=Judge(r); n=0
    for k,fs in enumerate(r.firings):
        j.hear(fs)
        for f in fs: c.update(f, r.array.blind)
        n=max(n,len(c.p))
        if k%EACH==0: j.compare(k,c.p,radius)
    j.n=n
    return j
